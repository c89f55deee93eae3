//! Wavefront OBJ with a material and its texture, for modelling programs.

use crate::mesh::Mesh;
use crate::mesh::skin::{Colors, Skin};
use std::fmt::Write as _;

/// The files of a mesh with normals and a skin's colours: `name.obj` and `name.mtl`, and the texture
/// `name.png` if there is one. Millimetres, as the mesh. Without a texture each vertex has its colour
/// after its place (`v x y z r g b`), as most programs read it.
pub fn files(mesh: &Mesh, skin: &Skin, name: &str) -> Vec<(String, Vec<u8>)> {
    let mut text = format!("# onescan\nmtllib {name}.mtl\no {name}\n");
    let mut line = |line: std::fmt::Arguments<'_>| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{line}");
    };
    let (colors, uvs): (&[_], &[_]) = match &skin.colors {
        Colors::Vertices(colors) => (colors, &[]),
        Colors::Texture(texture) => (&[], &texture.uvs),
    };
    for (i, [x, y, z]) in mesh.points.iter().enumerate() {
        match colors.get(i) {
            Some([r, g, b]) => line(format_args!("v {x} {y} {z} {r} {g} {b}")),
            None => line(format_args!("v {x} {y} {z}")),
        }
    }
    for [u, v] in uvs {
        // Up, here.
        line(format_args!("vt {u} {}", 1.0 - v));
    }
    for [x, y, z] in mesh.whole_normals() {
        line(format_args!("vn {x} {y} {z}"));
    }
    line(format_args!("usemtl skin"));
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| u64::from(i) + 1);
        if uvs.is_empty() {
            line(format_args!("f {a}//{a} {b}//{b} {c}//{c}"));
        } else {
            line(format_args!("f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}"));
        }
    }
    // 1: lit, without highlights; 0: the colour alone.
    let mut material =
        format!("# onescan\nnewmtl skin\nKd 1 1 1\nKs 0 0 0\nillum {}\n", u8::from(skin.lit));
    let mut files = vec![(format!("{name}.obj"), text.into_bytes())];
    if let Colors::Texture(texture) = &skin.colors {
        let _ = writeln!(material, "map_Kd {name}.png");
        files.push((format!("{name}.png"), texture.png.clone()));
    }
    files.push((format!("{name}.mtl"), material.into_bytes()));
    files
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::skin::Texture;
    use crate::photo::picture::Picture;
    use crate::scan::mesh_file::{self, Options};

    /// What our reader finds in the files.
    fn read_back(colors: Colors) -> Mesh {
        let mesh = Mesh {
            points: vec![[0.0; 3], [1.5, 0.0, 0.0], [0.0, -2.0, 0.25], [1.0; 3]],
            colors: vec![[0.0; 3]; 4],
            triangles: vec![[0, 1, 2], [1, 3, 2]],
        };
        let place = tempfile::tempdir().unwrap();
        for (name, bytes) in files(&mesh, &Skin { colors, lit: false }, "face") {
            std::fs::write(place.path().join(name), bytes).unwrap();
        }
        let mesh_file::Scan { mesh: found, .. } =
            mesh_file::read(&place.path().join("face.obj"), &Options::default()).unwrap();
        assert_eq!((&found.points, &found.triangles), (&mesh.points, &mesh.triangles));
        found
    }

    #[test]
    fn another_program_finds_mesh_and_texture() {
        let picture = Picture::from_fn(2, 2, |x, y| [255 * x as u8, 255 * y as u8, 51]);
        let uvs = vec![[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]];
        let found = read_back(Colors::Texture(Texture::new(uvs, picture).unwrap()));
        assert_eq!(
            found.colors,
            [[0.0, 0.0, 0.2], [1.0, 0.0, 0.2], [0.0, 1.0, 0.2], [1.0, 1.0, 0.2]]
        );
    }

    #[test]
    fn without_a_texture_vertices_have_colours() {
        let colors = vec![[0.125, 0.5, 1.0], [0.25; 3], [0.75; 3], [0.0; 3]];
        assert_eq!(read_back(Colors::Vertices(colors.clone())).colors, colors);
    }
}
