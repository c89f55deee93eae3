//! A photo is decoded or refused, whatever its bytes.
#![no_main]
use image::ImageReader;
use libfuzzer_sys::fuzz_target;
use onescan::photo;
use std::io::Cursor;

fuzz_target!(|data: &[u8]| {
    // A large picture is legitimate, and only slow; a vast one must be refused.
    let header = ImageReader::new(Cursor::new(data)).with_guessed_format();
    let size = header.ok().and_then(|reader| reader.into_dimensions().ok());
    let pixels = size.map_or(0, |(width, height)| u64::from(width) * u64::from(height));
    if (1 << 20..=photo::MAX_PIXELS).contains(&pixels) {
        return;
    }
    if let Ok(picture) = photo::decode(data) {
        assert!(picture.width > 0 && picture.height > 0);
        assert_eq!(picture.rgb.len(), picture.width as usize * picture.height as usize);
    }
});
