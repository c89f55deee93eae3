//! Numbers, names and bytes as text for a page.

use std::fmt;
use std::fmt::Write as _;

/// A string as HTML text or attribute value.
pub(crate) struct Escaped<'a>(pub(crate) &'a str);

impl fmt::Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.0.chars() {
            match c {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\'' => f.write_str("&#39;")?,
                c => f.write_char(c)?,
            }
        }
        Ok(())
    }
}

/// A relative address: every byte a URL path could misread is percent-encoded.
pub(super) fn address(parts: &[&str]) -> String {
    let mut out = String::new();
    for part in parts.iter().filter(|part| !part.is_empty()) {
        if !out.is_empty() {
            out.push('/');
        }
        for byte in part.bytes() {
            if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
                out.push(char::from(byte));
            } else {
                // Writing to a string cannot fail.
                let _ = write!(out, "%{byte:02X}");
            }
        }
    }
    out
}

/// A number with a true minus sign and thousands set apart by narrow spaces.
pub(super) fn number(value: f64, decimals: usize) -> String {
    let digits = format!("{:.decimals$}", value.abs());
    let whole = digits.find('.').unwrap_or(digits.len());
    let negative = value < 0.0 && digits.bytes().any(|b| (b'1'..=b'9').contains(&b));
    let mut out = String::from(if negative { "\u{2212}" } else { "" });
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && i < whole && (whole - i) % 3 == 0 {
            out.push('\u{202f}');
        }
        out.push(c);
    }
    out
}

/// A log likelihood; what is below every likelihood a picture can have is "none".
pub(super) fn likelihood(value: f64) -> String {
    if value < -1e300 { "none".to_owned() } else { number(value, 0) }
}

/// A share of one in percent.
pub(super) fn percent(share: f64, decimals: usize) -> String {
    format!("{} %", number(100.0 * share, decimals))
}

/// A length in millimetres with the word for its sign, `12 mm up`.
pub(super) fn shifted(millimetres: f64, positive: &str, negative: &str) -> String {
    let word = if millimetres < 0.0 { negative } else { positive };
    format!("{} mm {word}", number(millimetres.abs(), 0))
}

/// An angle in degrees with the word for its sign, `12.3° left`; no word for zero.
pub(super) fn turned(radians: f32, positive: &str, negative: &str) -> String {
    let half = std::f32::consts::PI;
    // A chain may have gone round once or twice.
    let degrees = ((radians + half).rem_euclid(2.0 * half) - half).to_degrees();
    let text = number(f64::from(degrees.abs()), 1);
    match degrees {
        _ if text == "0.0" => "0.0°".to_owned(),
        d if d > 0.0 => format!("{text}° {positive}"),
        _ => format!("{text}° {negative}"),
    }
}

/// Base 64 with padding (RFC 4648), as data URIs carry it.
pub(super) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let byte = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i)) as usize & 63];
            out.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_is_harmless() {
        assert_eq!(Escaped("<a href='x'>&\"").to_string(), "&lt;a href=&#39;x&#39;&gt;&amp;&quot;");
        assert_eq!(address(&["", "a b", "ü?.glb"]), "a%20b/%C3%BC%3F.glb");
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(number(-1_234_567.89, 1), "\u{2212}1\u{202f}234\u{202f}567.9");
        assert_eq!(number(-0.04, 1), "0.0");
        assert_eq!(number(999.0, 0), "999");
        assert_eq!(number(-100_000.0, 0), "\u{2212}100\u{202f}000");
        assert_eq!(percent(0.0512, 1), "5.1 %");
        assert_eq!(shifted(-12.3, "up", "down"), "12 mm down");
        assert_eq!(likelihood(f64::MIN), "none");
        assert_eq!(turned(0.1, "left", "right"), "5.7° left");
        assert_eq!(turned(std::f32::consts::TAU - 0.1, "left", "right"), "5.7° right");
    }

    #[test]
    fn base64_as_in_rfc_4648() {
        for (bytes, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }
}
