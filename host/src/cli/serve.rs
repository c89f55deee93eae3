//! `onescan serve`.

use clap::Args;
use flate2::write::GzEncoder;
use flate2::{Compression, Crc};
use onescan::error::{Error, Result};
use onescan::progress::print;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use tiny_http::{Header, Method, Request, Response, Server};

/// Requests that are answered at a time, so that one who reads slowly does not keep the others waiting.
const THREADS: usize = 8;
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
        let server = Server::http((Ipv4Addr::LOCALHOST, self.port)).map_err(|e| {
            Error::new(format_args!("port {}: {e}; give another by --port", self.port))
        })?;
        let port = server.server_addr().to_ip().map_or(self.port, |address| address.port());
        print(format_args!("http://127.0.0.1:{port}"))?;
        let answer = || {
            for request in server.incoming_requests() {
                // Whoever asked may have gone; the next is answered all the same.
                let _ = site.answer(request, port);
            }
        };
        std::thread::scope(|scope| (0..THREADS).for_each(|_| drop(scope.spawn(answer))));
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

    /// Answers a request to this port. Other hosts' names are refused: a site whose name is made to lead
    /// here (DNS rebinding) shall not be taken for this one.
    fn answer(&self, request: Request, port: u16) -> std::io::Result<()> {
        let asked = |name: &'static str| {
            let header = request.headers().iter().find(|header| header.field.equiv(name));
            header.map_or("", |header| header.value.as_str())
        };
        let host = asked("Host");
        if ![format!("127.0.0.1:{port}"), format!("localhost:{port}")].iter().any(|own| own == host)
        {
            return request.respond(text("this is another host", 421));
        }
        if !matches!(request.method(), Method::Get | Method::Head) {
            return request.respond(text("only GET and HEAD", 405));
        }
        let path = request.url().split(['?', '#']).next().unwrap_or_default();
        let path = match path.trim_start_matches('/') {
            "" => "index.html",
            path => path,
        };
        let Some(file) = self.0.get(path) else {
            return request.respond(text("no such file", 404));
        };
        let mut headers = vec![
            ("Content-Type", kind(path)),
            ("Cache-Control", "no-cache"),
            ("ETag", &*file.tag),
            ("Vary", "Accept-Encoding"),
            // What scripts may do the page says itself; nothing may frame it.
            ("Content-Security-Policy", "frame-ancestors 'none'"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
        ];
        let known = asked("If-None-Match").split(',').any(|tag| tag.trim() == file.tag);
        let packed = asked("Accept-Encoding").split([',', ';']).any(|way| way.trim() == "gzip");
        let (status, bytes): (u16, &[u8]) = match &file.gzip {
            _ if known => (304, &[]),
            Some(gzip) if packed => {
                headers.push(("Content-Encoding", "gzip"));
                (200, gzip)
            }
            _ => (200, &file.bytes),
        };
        let headers = headers.into_iter();
        let headers =
            headers.filter_map(|(name, value)| Header::from_bytes(name, value).ok()).collect();
        let length = Some(bytes.len());
        request.respond(Response::new(status.into(), headers, bytes, length, None))
    }
}

fn text(said: &str, status: u16) -> Response<std::io::Cursor<Vec<u8>>> {
    Response::from_string(format!("{said}\n")).with_status_code(status)
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
