//! Draws docs/landmarks.svg: the landmarks of the built-in face, with their names.
//!
//!     cargo run --release --example landmark_chart > docs/landmarks.svg

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use onescan::demo::template;
use onescan::error::Result;
use onescan::model::layout;
use onescan::render;

/// Side of the picture, and the width beside it for names.
const SIDE: u32 = 560;
const MARGIN: f32 = 260.0;

fn main() -> Result<()> {
    let (mesh, landmarks) = template()?;
    let rigid = layout::rigid(&mesh, &[])?;
    let scene = render::portrait(&rigid.view(), [SIDE; 2], 0.0, 0.0);
    let png = render::draw_on(&rigid.view(), &scene, [255; 3]).to_png()?;
    let width = SIDE as f32 + 2.0 * MARGIN;
    println!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {SIDE}\" font-family=\"sans-serif\" \
         font-size=\"13\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/><image x=\"{MARGIN}\" \
         width=\"{SIDE}\" height=\"{SIDE}\" href=\"data:image/png;base64,{}\"/>",
        BASE64_STANDARD.encode(png)
    );
    let place = |vertex: u32| {
        let point = scene.view.pose.to_world(mesh.points[vertex as usize]);
        let (x, y, _) = scene.view.camera.project(point);
        [MARGIN + x, y]
    };
    let mut marks: Vec<_> =
        landmarks.iter().map(|mark| (mark.name.as_str(), place(mark.vertex))).collect();
    marks.sort_by(|a, b| a.1[1].total_cmp(&b.1[1]));
    // The subject's right is on the left; those of the middle take turns.
    let mut middle = 0;
    let (on_left, on_right): (Vec<_>, Vec<_>) = marks.into_iter().partition(|(name, _)| {
        middle += usize::from(name.starts_with("center"));
        name.starts_with("right") || (name.starts_with("center") && middle % 2 == 1)
    });
    for (names, x, anchor) in
        [(on_left, MARGIN - 8.0, "end"), (on_right, width - MARGIN + 8.0, "start")]
    {
        let step = SIDE as f32 / names.len() as f32;
        for (i, (name, [px, py])) in names.iter().enumerate() {
            let y = (i as f32 + 0.5) * step;
            println!(
                "<path d=\"M{x} {y}L{px} {py}\" stroke=\"#888\" stroke-width=\".6\"/><circle cx=\"{px}\" \
                 cy=\"{py}\" r=\"3\" fill=\"#ffdc28\" stroke=\"#000\"/><text x=\"{x}\" y=\"{}\" \
                 text-anchor=\"{anchor}\">{name}</text>",
                y + 4.0
            );
        }
    }
    println!("</svg>");
    Ok(())
}
