//! A coloured triangle mesh in memory.

/// A triangle mesh with a colour per vertex.
///
/// Guarantees, established by the readers: as many colours as points, all numbers finite,
/// every index of a triangle below the number of points, at least one triangle.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Vertex positions, millimetres.
    pub points: Vec<[f32; 3]>,
    /// Vertex colours, RGB in `[0, 1]` as stored in files (sRGB, never linearised).
    pub colors: Vec<[f32; 3]>,
    /// Corner indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}
