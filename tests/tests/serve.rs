//! The page by `onescan serve`.

use onescan_tests::program::Onescan;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use tempfile::tempdir;

/// What a server answers to a request, which has these lines: its head and its body.
fn answer(address: &str, lines: &[&str]) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "{}\r\nConnection: close\r\n\r\n", lines.join("\r\n")).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").expect("a head ends");
    (String::from_utf8_lossy(&bytes[..end]).into_owned(), bytes[end + 4..].to_vec())
}

#[test]
fn the_page_is_served_to_this_machine_alone() {
    let place = tempdir().unwrap();
    let page = place.path().join("page/js");
    fs::create_dir_all(&page).unwrap();
    let script = "export const x = 1;\n".repeat(100);
    fs::write(page.join("app.js"), &script).unwrap();
    fs::write(page.join("a.wasm"), b"\0asm").unwrap();
    fs::write(place.path().join("page/index.html"), "<!doctype html><title>page</title>").unwrap();
    fs::write(place.path().join("secret.txt"), "secret").unwrap();

    let none = Onescan::new(place.path(), "serve --page page/js").run();
    assert_eq!(none.code, Some(1));
    assert!(none.stderr.contains("has no index.html"), "{}", none.stderr);

    let mut server = Onescan::new(place.path(), "serve --port 0 --page page").start();
    let mut line = String::new();
    BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim_start_matches("open http://").split('/').next().unwrap().to_owned();
    assert!(address.starts_with("127.0.0.1:"), "{line}");
    let host = format!("Host: {address}");
    let get = |path: &str, more: &[&str]| {
        let first = format!("GET {path} HTTP/1.1");
        answer(&address, &[&[first.as_str(), host.as_str()], more].concat())
    };

    let (head, body) = get("/", &[]);
    assert!(head.starts_with("HTTP/1.1 200") && head.contains("text/html"), "{head}");
    assert!(head.contains("frame-ancestors 'none'") && head.contains("nosniff"), "{head}");
    assert_eq!(body, b"<!doctype html><title>page</title>");
    assert!(get("/js/a.wasm", &[]).0.contains("application/wasm"));

    let (head, body) = get("/js/app.js?x=1", &["Accept-Encoding: br, gzip"]);
    assert!(head.contains("Content-Encoding: gzip") && body.len() < script.len() / 4, "{head}");
    let (head, body) = get("/js/app.js", &[]);
    assert!(!head.contains("Content-Encoding") && body == script.as_bytes(), "{head}");
    let tag = head.lines().find_map(|line| line.strip_prefix("ETag: ")).unwrap();
    let (head, body) = get("/js/app.js", &[&format!("If-None-Match: {tag}")]);
    assert!(head.starts_with("HTTP/1.1 304") && body.is_empty(), "{head}");

    for path in ["/../secret.txt", "/%2e%2e/secret.txt", "/js/../../secret.txt", "//etc/passwd"] {
        let (head, body) = get(path, &[]);
        assert!(head.starts_with("HTTP/1.1 404"), "{path}: {head}");
        assert!(!String::from_utf8_lossy(&body).contains("secret"), "{path}");
    }
    for other in ["Host: evil.example", "Host: localhost.evil.example:1", "X: y"] {
        let (head, _) = answer(&address, &["GET / HTTP/1.1", other]);
        assert!(head.starts_with("HTTP/1.1 421"), "{other}: {head}");
    }
    let (head, _) = answer(&address, &["POST / HTTP/1.1", &host, "Content-Length: 0"]);
    assert!(head.starts_with("HTTP/1.1 405"), "{head}");
    server.kill().unwrap();
    server.wait().unwrap();
}
