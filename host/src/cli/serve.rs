//! `onescan serve`.

use clap::Args;
use flate2::Compression;
use flate2::write::GzEncoder;
use onescan::error::{Error, Result};
use onescan::files;
use onescan::progress::{complain, print};
use onescan_core::hash::fnv64;
use percent_encoding::percent_decode_str;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use tiny_http::{Header, Method, Request, Response, Server};

/// Show the page in which photos are fitted, on this machine alone.
///
/// Serves it on 127.0.0.1, so that no other machine reaches it, and prints the address to open in a
/// browser; Ctrl-C ends it. Landmarks are found and placed there, on photos.
#[derive(Args)]
pub(super) struct Serve {
    /// Port of this machine; 0 for any that is free.
    #[arg(long, default_value_t = 8080)]
    port: u16,
    /// The page's directory, as `cargo xtask wasm` makes it in wasm/dist [default: the page inside this
    /// program, if it was built with `--features serve`].
    #[arg(long, value_name = "DIR")]
    page: Option<PathBuf>,
}

/// Requests that are answered at a time: more than a browser makes.
const THREADS: usize = 8;
/// Headers of every answer. What scripts may do the page says itself; nothing may frame it.
const HEADERS: [(&str, &str); 5] = [
    ("Content-Security-Policy", "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    // Asked for again each time, and not sent again while it is the same.
    ("Cache-Control", "no-cache"),
];

impl Serve {
    pub(super) fn run(self) -> Result<()> {
        let site = self.site()?;
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, self.port));
        let server = Server::http(address).map_err(|e| {
            Error::new(format_args!("cannot serve on {address}: {e}; give another --port"))
        })?;
        let address = server.server_addr().to_ip().unwrap_or(address);
        print(format_args!("open http://{address}/ (Ctrl-C ends this)"))?;
        std::thread::scope(|scope| {
            for _ in 0..THREADS {
                scope.spawn(|| {
                    while let Ok(request) = server.recv() {
                        answer(request, &site, address.port());
                    }
                });
            }
        });
        Ok(())
    }

    fn site(&self) -> Result<Site> {
        let Some(directory) = &self.page else { return inside() };
        let mut site = Site::new();
        collect(directory, "", &mut site)?;
        if site.contains_key("index.html") {
            Ok(site)
        } else {
            Err(Error::file(
                directory,
                "has no index.html; give the page's directory, which `cargo xtask wasm` makes: wasm/dist",
            ))
        }
    }
}

/// The page that is compiled in.
#[cfg(feature = "serve")]
#[expect(clippy::unnecessary_wraps, reason = "without the feature there is none")]
fn inside() -> Result<Site> {
    #[derive(rust_embed::Embed)]
    #[folder = "../wasm/dist"]
    struct Dist;
    let file = |name: std::borrow::Cow<'static, str>| {
        let bytes = Dist::get(&name)?.data.into_owned();
        Some((name.clone().into_owned(), File::new(&name, bytes)))
    };
    Ok(Dist::iter().filter_map(file).collect())
}

#[cfg(not(feature = "serve"))]
fn inside() -> Result<Site> {
    Err(Error::new(
        "this program was built without the page; build it with `cargo xtask wasm` and `cargo build \
         --release --features serve`, or name the page's directory by --page",
    ))
}

/// The page's files by their paths, with slashes.
type Site = BTreeMap<String, File>;

/// A file as it is sent.
struct File {
    kind: &'static str,
    bytes: Vec<u8>,
    /// If that is less.
    packed: Option<Vec<u8>>,
    /// Of its bytes.
    tag: String,
}

impl File {
    fn new(name: &str, bytes: Vec<u8>) -> Self {
        let extension = Path::new(name).extension().unwrap_or_default().to_ascii_lowercase();
        let (kind, pack) = match extension.to_str().unwrap_or_default() {
            "html" => ("text/html; charset=utf-8", true),
            "js" | "mjs" => ("text/javascript; charset=utf-8", true),
            "css" => ("text/css; charset=utf-8", true),
            "json" | "webmanifest" => ("application/json", true),
            "svg" => ("image/svg+xml", true),
            "wasm" => ("application/wasm", true),
            "png" => ("image/png", false),
            "jpg" | "jpeg" => ("image/jpeg", false),
            "gz" => ("application/gzip", false),
            "tflite" | "3dmm" => ("application/octet-stream", true),
            _ => ("text/plain; charset=utf-8", true),
        };
        let gzip = || {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&bytes).and_then(|()| encoder.finish()).ok()
        };
        let packed = pack.then(gzip).flatten().filter(|packed| packed.len() < bytes.len());
        Self { kind, tag: format!("\"{:016x}\"", fnv64(&bytes)), packed, bytes }
    }
}

/// Reads a directory's files, and those below it, but for hidden ones and links.
fn collect(directory: &Path, prefix: &str, site: &mut Site) -> Result<()> {
    let named = |e| Error::file(directory, e);
    for entry in fs::read_dir(directory).map_err(named)? {
        let entry = entry.map_err(named)?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(named)?);
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') || name == "node_modules" {
            continue;
        }
        if kind.is_dir() {
            collect(&path, &format!("{prefix}{name}/"), site)?;
        } else if kind.is_file() {
            let bytes = files::read(&path).map_err(|e| Error::file(&path, e))?;
            site.insert(format!("{prefix}{name}"), File::new(&name, bytes));
        }
    }
    Ok(())
}

/// The value of a request's header.
fn header<'a>(request: &'a Request, name: &'static str) -> &'a str {
    let found = request.headers().iter().find(|header| header.field.equiv(name));
    found.map_or("", |header| header.value.as_str())
}

/// Whether a request is meant for this server: other names that lead here are a stranger's, who wants
/// the browser to take the page for his.
fn is_own(host: &str, port: u16) -> bool {
    ["127.0.0.1", "localhost"].iter().any(|name| {
        host.strip_prefix(name)
            .is_some_and(|rest| rest == format!(":{port}") || rest.is_empty() && port == 80)
    })
}

/// Answers a request from the files in memory: nothing is looked for on the disk.
fn answer(request: Request, site: &Site, port: u16) {
    let refused = |status: u16, text: &str| {
        Response::from_string(text)
            .with_status_code(status)
            .with_header(field("Allow", "GET, HEAD"))
    };
    let path = request.url().split(['?', '#']).next().unwrap_or_default();
    let path = percent_decode_str(path.trim_start_matches('/')).decode_utf8_lossy().into_owned();
    let file = site.get(if path.is_empty() { "index.html" } else { &path });
    let response = match (request.method(), file) {
        _ if !is_own(header(&request, "Host"), port) => refused(421, "not this server's name\n"),
        (Method::Get | Method::Head, Some(file)) => file.response(&request),
        (Method::Get | Method::Head, None) => refused(404, "no such file\n"),
        _ => refused(405, "only GET and HEAD\n"),
    };
    let response =
        HEADERS.iter().fold(response, |r, (name, value)| r.with_header(field(name, value)));
    if let Err(e) = request.respond(response)
        && !matches!(e.kind(), std::io::ErrorKind::BrokenPipe | std::io::ErrorKind::ConnectionReset)
    {
        complain(format_args!("onescan: cannot answer: {e}"));
    }
}

impl File {
    fn response(&self, request: &Request) -> Response<std::io::Cursor<Vec<u8>>> {
        let same = header(request, "If-None-Match")
            .split(',')
            .any(|tag| tag.trim().trim_start_matches("W/") == self.tag);
        let takes_gzip = header(request, "Accept-Encoding").split(',').any(|coding| {
            let mut words = coding.split(';').map(str::trim);
            words.next() == Some("gzip") && words.next() != Some("q=0")
        });
        let packed = self.packed.as_ref().filter(|_| takes_gzip);
        let bytes = match packed {
            _ if same => Vec::new(),
            Some(packed) => packed.clone(),
            None => self.bytes.clone(),
        };
        let mut response = Response::from_data(bytes)
            .with_status_code(if same { 304 } else { 200 })
            .with_header(field("Content-Type", self.kind))
            .with_header(field("Vary", "Accept-Encoding"))
            .with_header(field("ETag", &self.tag));
        if packed.is_some() && !same {
            response.add_header(field("Content-Encoding", "gzip"));
        }
        // Lengths are known, and pages' progress bars want them.
        response.with_chunked_threshold(usize::MAX)
    }
}

fn field(name: &str, value: &str) -> Header {
    // All are plain words of this file.
    Header::from_bytes(name, value).unwrap_or_else(|()| unreachable!("{name}: {value}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_own_names_are_answered() {
        for (host, own) in [
            ("127.0.0.1:8080", true),
            ("localhost:8080", true),
            ("localhost:80", false),
            ("localhost", false),
            ("localhost.evil.com:8080", false),
            ("evil.com:8080", false),
            ("", false),
        ] {
            assert_eq!(is_own(host, 8080), own, "{host}");
        }
        assert!(is_own("localhost", 80));
    }
}
