//! `onescan serve`.

use clap::Args;
use flate2::write::GzEncoder;
use flate2::{Compression, Crc};
use onescan::error::{Error, Result};
use onescan::progress::print;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Connections that are answered at a time, so that those who ask or read slowly do not keep the others
/// waiting. Browsers open some in advance.
const THREADS: usize = 64;
/// How long a connection may take to ask, and to read each part of an answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long after an answer is waited for the other side to have it, at most.
const FAREWELL: Duration = Duration::from_secs(1);
/// Most bytes of a request, and of its lines.
const HEAD: usize = 1 << 14;
const LINES: usize = 64;
/// Bytes of an answer that are written at a time.
const PART: usize = 1 << 16;
/// Largest file of a page, bytes. Chosen, not measured.
const MOST: u64 = 1 << 26;

/// Serve the page, which fits faces in the browser, to this computer's browsers.
///
/// Nothing leaves the computer: the page is served to it alone (127.0.0.1), and photos are read and
/// fitted in the browser. Ctrl-C ends it.
///
/// Example: onescan serve
#[derive(Args)]
pub(super) struct Serve {
    /// Port; 0 takes a free one.
    #[arg(long, default_value_t = 8080)]
    port: u16,
    /// Directory of the page, instead of the one in this program; `cargo xtask wasm` makes wasm/dist.
    #[arg(long, value_name = "DIR")]
    page: Option<PathBuf>,
}

impl Serve {
    pub(super) fn run(self) -> Result<()> {
        let site = match &self.page {
            Some(directory) => Site::read(directory)?,
            None => Site::own()?,
        };
        let fault = |e| Error::new(format_args!("port {}: {e}; give another by --port", self.port));
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, self.port)).map_err(fault)?;
        let port = listener.local_addr().map_err(fault)?.port();
        print(format_args!("http://127.0.0.1:{port}"))?;
        let answer = || {
            loop {
                match listener.accept() {
                    // Whoever asked may have gone; the next is answered all the same.
                    Ok((stream, _)) => drop(site.talk(&stream, port)),
                    // As many connections as there may be: some will end.
                    Err(_) => thread::sleep(FAREWELL),
                }
            }
        };
        thread::scope(|scope| (0..THREADS).for_each(|_| drop(scope.spawn(answer))));
        Ok(())
    }
}

/// A file of the page.
struct File {
    bytes: Cow<'static, [u8]>,
    /// The same compressed, if that is less.
    gzip: Option<Vec<u8>>,
    /// Quoted, as HTTP has it.
    tag: String,
}

/// The page's files by their paths from its root.
struct Site(BTreeMap<String, File>);

impl Site {
    fn new(files: impl IntoIterator<Item = (String, Cow<'static, [u8]>)>) -> Result<Self> {
        let mut site = BTreeMap::new();
        for (path, bytes) in files {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&bytes).map_err(Error::new)?;
            let gzip = encoder.finish().map_err(Error::new)?;
            let gzip = (gzip.len() < bytes.len() / 10 * 9).then_some(gzip);
            let mut sum = Crc::new();
            sum.update(&bytes);
            let tag = format!("\"{:08x}-{}\"", sum.sum(), bytes.len());
            site.insert(path, File { bytes, gzip, tag });
        }
        Ok(Self(site))
    }

    /// The page in this program.
    #[cfg(feature = "page")]
    fn own() -> Result<Self> {
        static PAGE: include_dir::Dir<'_> =
            include_dir::include_dir!("$CARGO_MANIFEST_DIR/../wasm/dist");
        let mut files = Vec::new();
        let mut rest = vec![&PAGE];
        while let Some(directory) = rest.pop() {
            rest.extend(directory.dirs());
            files.extend(directory.files().filter_map(|file| {
                Some((file.path().to_str()?.replace('\\', "/"), Cow::Borrowed(file.contents())))
            }));
        }
        Self::new(files)
    }

    /// The page in this program, which has none.
    #[cfg(not(feature = "page"))]
    fn own() -> Result<Self> {
        Err(Error::new(
            "this program was built without the page; build it by `cargo xtask wasm` and then `cargo build \
             --release --features page`, or give --page wasm/dist",
        ))
    }

    /// The page in a directory.
    fn read(directory: &Path) -> Result<Self> {
        let mut files = Vec::new();
        let mut rest = vec![directory.to_path_buf()];
        while let Some(place) = rest.pop() {
            for entry in fs::read_dir(&place).map_err(|e| Error::file(&place, e))? {
                let entry = entry.map_err(|e| Error::file(&place, e))?;
                let (path, kind) = (entry.path(), entry.file_type());
                let kind = kind.map_err(|e| Error::file(&path, e))?;
                if kind.is_dir() {
                    rest.push(path);
                } else if kind.is_file() {
                    let size = entry.metadata().map_err(|e| Error::file(&path, e))?.len();
                    if size > MOST {
                        let large =
                            format_args!("{size} bytes are too many for a page; is it one?");
                        return Err(Error::file(&path, large));
                    }
                    let bytes = fs::read(&path).map_err(|e| Error::file(&path, e))?;
                    let name = path.strip_prefix(directory).unwrap_or(&path).to_string_lossy();
                    files.push((name.replace('\\', "/"), Cow::Owned(bytes)));
                }
            }
        }
        if !files.iter().any(|(name, _)| name == "index.html") {
            return Err(Error::file(
                directory,
                "has no index.html; `cargo xtask wasm` makes wasm/dist",
            ));
        }
        Self::new(files)
    }

    /// Answers one request of a connection to this port.
    fn talk(&self, mut stream: &TcpStream, port: u16) -> io::Result<()> {
        stream.set_write_timeout(Some(PATIENCE))?;
        let head = ask(stream)?;
        let (head, body) = self.answer(&head, port);
        stream.write_all(head.as_bytes())?;
        for part in body.chunks(PART) {
            stream.write_all(part)?;
        }
        // What was sent and not read would have the answer thrown away.
        stream.shutdown(Shutdown::Write)?;
        stream.set_read_timeout(Some(FAREWELL))?;
        io::copy(&mut stream.take(HEAD as u64), &mut io::sink())?;
        Ok(())
    }

    /// The answer to a request at this port, head and body. Other hosts' names are refused: a site whose name is made to
    /// lead here (DNS rebinding) shall not be taken for this one.
    fn answer(&self, head: &[u8], port: u16) -> (String, &[u8]) {
        let mut lines = [httparse::EMPTY_HEADER; LINES];
        let mut request = httparse::Request::new(&mut lines);
        if !request.parse(head).is_ok_and(|parsed| parsed.is_complete()) {
            return text("not a request\n", "400 Bad Request");
        }
        let asked = |name: &str| {
            let line = request.headers.iter().find(|line| line.name.eq_ignore_ascii_case(name));
            line.and_then(|line| str::from_utf8(line.value).ok()).unwrap_or_default()
        };
        let host = asked("Host");
        if ![format!("127.0.0.1:{port}"), format!("localhost:{port}")].iter().any(|own| own == host)
        {
            return text("this is another host\n", "421 Misdirected Request");
        }
        let method = request.method.unwrap_or_default();
        if !matches!(method, "GET" | "HEAD") {
            return text("only GET and HEAD\n", "405 Method Not Allowed");
        }
        let path = request.path.unwrap_or_default().split(['?', '#']).next().unwrap_or_default();
        let path = match path.trim_start_matches('/') {
            "" => "index.html",
            path => path,
        };
        let Some(file) = self.0.get(path) else {
            return text("no such file\n", "404 Not Found");
        };
        let known = asked("If-None-Match").split(',').any(|tag| tag.trim() == file.tag);
        let packed = asked("Accept-Encoding").split([',', ';']).any(|way| way.trim() == "gzip");
        let (encoding, bytes): (_, &[u8]) = match &file.gzip {
            Some(gzip) if packed => ("Content-Encoding: gzip\r\n", gzip),
            _ => ("", &file.bytes),
        };
        let status = if known { "304 Not Modified" } else { "200 OK" };
        // What scripts may do the page says itself; nothing may frame it.
        let more = format!(
            "{encoding}Cache-Control: no-cache\r\nETag: {}\r\nVary: Accept-Encoding\r\n\
             Content-Security-Policy: frame-ancestors 'none'\r\nX-Content-Type-Options: nosniff\r\n\
             Referrer-Policy: no-referrer\r\nCross-Origin-Opener-Policy: same-origin\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\n",
            file.tag
        );
        let head = heading(status, kind(path), bytes.len(), &more);
        (head, if known || method == "HEAD" { &[] } else { bytes })
    }
}

/// What a connection asks: all until an empty line, or as much as came in time.
fn ask(mut stream: &TcpStream) -> io::Result<Vec<u8>> {
    let until = Instant::now() + PATIENCE;
    let mut head = Vec::new();
    let mut part = [0; 1024];
    while head.len() < HEAD && !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut part)? {
            0 => break,
            read => head.extend_from_slice(&part[..read]),
        }
    }
    Ok(head)
}

/// An answer's head, with `more` lines.
fn heading(status: &str, kind: &str, length: usize, more: &str) -> String {
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n\
         Connection: close\r\n{more}\r\n"
    )
}

fn text(said: &'static str, status: &str) -> (String, &'static [u8]) {
    (heading(status, "text/plain; charset=utf-8", said.len(), ""), said.as_bytes())
}

/// The media type of a file of the page.
fn kind(path: &str) -> &'static str {
    match path.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("jpg") => "image/jpeg",
        Some("json") => "application/json",
        Some("wasm") => "application/wasm",
        Some("tlms" | "txt" | "ts" | "md") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}
