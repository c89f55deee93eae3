//! `onescan serve`: the page for this computer's browsers alone.

use onescan_tests::program::Onescan;
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::Child;
use std::time::{Duration, Instant};
use tempfile::tempdir;

/// A server, ended with the test.
struct Served(Child);

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What a server at a port answers: head and body.
fn ask(port: &str, request: &str, headers: &str) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
    write!(stream, "{request} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n").unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let head = bytes.windows(4).position(|end| end == b"\r\n\r\n").unwrap();
    (String::from_utf8(bytes[..head].to_vec()).unwrap(), bytes[head + 4..].to_vec())
}

#[test]
fn the_page_is_served_to_this_computer_alone() {
    let place = tempdir().unwrap();
    let page = "<!doctype html><title>a face</title>".repeat(20);
    fs::create_dir_all(place.path().join("dist/page")).unwrap();
    fs::write(place.path().join("dist/index.html"), &page).unwrap();
    fs::write(place.path().join("dist/page/app.js"), "1").unwrap();
    fs::write(place.path().join("secret.txt"), "secret").unwrap();
    let start = Onescan::new(place.path(), "serve --port 0 --page dist").start();
    let mut server = Served(start);
    let mut line = String::new();
    BufReader::new(server.0.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    let port = line.trim().strip_prefix("http://127.0.0.1:").unwrap();
    let own = format!("Host: localhost:{port}\r\n");

    let (head, body) = ask(port, "GET /", &own);
    assert!(head.starts_with("HTTP/1.1 200 ") && head.contains("text/html"), "{head}");
    assert_eq!(body, page.as_bytes());
    let (head, body) = ask(port, "GET /?again", &format!("{own}Accept-Encoding: br, gzip\r\n"));
    assert!(head.contains("Content-Encoding: gzip") && body.len() < page.len() / 4, "{head}");
    let tag = head.lines().find_map(|line| line.strip_prefix("ETag: ")).unwrap();
    let (head, body) = ask(port, "GET /index.html", &format!("{own}If-None-Match: {tag}\r\n"));
    assert!(head.starts_with("HTTP/1.1 304 ") && body.is_empty(), "{head}");
    let (head, body) = ask(port, "HEAD /page/app.js", &own);
    assert!(head.contains("text/javascript") && body.is_empty(), "{head}");

    for (request, headers, status) in [
        ("GET /", "Host: evil.example\r\n", "421"),
        ("GET /", "", "421"),
        ("POST /", &*own, "405"),
        ("POST /", &format!("{own}Content-Length: 99999999999\r\n"), "405"),
        ("GET /", &format!("{own}X: {}\r\n", "a".repeat(1 << 14)), "400"),
        ("GET /", &format!("{own}{}", "A: b\r\n".repeat(100)), "400"),
        ("\u{16}\u{3}", "", "400"),
        ("GET /../secret.txt", &own, "404"),
        ("GET /page/%2e%2e/%2e%2e/secret.txt", &own, "404"),
        ("GET /nothing", &own, "404"),
    ] {
        let (head, _) = ask(port, request, headers);
        assert!(head.starts_with(&format!("HTTP/1.1 {status} ")), "{request}: {head}");
    }

    // Who asks nothing, asks half or does not read keeps nobody waiting.
    let idle: Vec<_> = (0..40)
        .map(|i| {
            let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
            stream.write_all(&b"GET / HTTP/1.1\r\n"[..i % 17]).unwrap();
            stream
        })
        .collect();
    let start = Instant::now();
    assert_eq!(ask(port, "GET /", &own).1, page.as_bytes());
    assert!(start.elapsed() < Duration::from_secs(2));
    drop(idle);

    let taken = Onescan::new(place.path(), &format!("serve --port {port} --page dist")).run();
    assert_eq!(taken.code, Some(1));
    assert!(taken.stderr.contains("give another by --port"), "{}", taken.stderr);
    let none = Onescan::new(place.path(), "serve --page .").run();
    assert!(none.stderr.contains("has no index.html"), "{}", none.stderr);
    let none = Onescan::new(place.path(), "serve --port 0").run();
    assert!(none.stderr.contains("without the page"), "{}", none.stderr);
}
