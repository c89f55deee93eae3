//! Where a glTF file's vertices lie: by nodes, joints and morph targets.

use super::buffers::Buffers;
use crate::error::{Error, Result};
use ::gltf::{Document, Mesh, Node, Primitive, Semantic};
use std::collections::{HashMap, HashSet};
use std::rc::Rc;

/// Columns first.
type Matrix = [[f64; 4]; 4];

const IDENTITY: Matrix = [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]];

/// A mesh in its scene.
pub(super) struct Placed<'a> {
    pub(super) mesh: Mesh<'a>,
    node: Option<Node<'a>>,
    matrix: Matrix,
    /// Transforms of all nodes in the scene, if the mesh has a skin.
    nodes: Option<Rc<HashMap<usize, Matrix>>>,
}

/// The meshes of the default scene, or the first; of the file, if it has no scene or that is empty.
///
/// # Errors
/// Nodes in a circle, scenes without meshes.
pub(super) fn placed(document: &Document) -> Result<Vec<Placed<'_>>> {
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let Some(scene) = scene.filter(|scene| scene.nodes().len() > 0) else {
        let alone = |mesh| Placed { mesh, node: None, matrix: IDENTITY, nodes: None };
        return Ok(document.meshes().map(alone).collect());
    };
    let mut found = Vec::new();
    let mut matrices = HashMap::new();
    let mut seen = HashSet::new();
    let mut open: Vec<_> = scene.nodes().map(|node| (node, IDENTITY)).collect();
    // Taken from the end: so the file's order is kept.
    open.reverse();
    while let Some((node, parent)) = open.pop() {
        // A node that occurs again makes a circle, or an avalanche.
        if !seen.insert(node.index()) {
            return Err(Error::new(format_args!(
                "node {} has two parents; the file is damaged, export it again",
                node.index()
            )));
        }
        let local = node.transform().matrix().map(|column| column.map(f64::from));
        let matrix = product(&parent, &local);
        matrices.insert(node.index(), matrix);
        let next = open.len();
        open.extend(node.children().map(|child| (child, matrix)));
        open[next..].reverse();
        if let Some(mesh) = node.mesh() {
            found.push(Placed { mesh, node: Some(node), matrix, nodes: None });
        }
    }
    if found.is_empty() {
        return Err(Error::new("the scene holds no mesh; export the scan with its mesh"));
    }
    let matrices = Rc::new(matrices);
    for placed in &mut found {
        if placed.node.as_ref().is_some_and(|node| node.skin().is_some()) {
            placed.nodes = Some(Rc::clone(&matrices));
        }
    }
    Ok(found)
}

/// The positions of a primitive, if it has any, moved by its morph targets as their default weights
/// say, which are the node's or else the mesh's.
///
/// # Errors
/// Accessors that do not fit.
pub(super) fn morphed(
    buffers: &Buffers,
    primitive: &Primitive<'_>,
    placed: &Placed<'_>,
) -> Result<Option<Vec<[f64; 3]>>> {
    let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(None) };
    let positions = buffers.numbers::<3>(&positions)?;
    let mut positions: Vec<_> = positions.into_iter().map(|p| p.map(f64::from)).collect();
    let own = placed.node.as_ref().and_then(Node::weights);
    let weights = own.or(placed.mesh.weights()).unwrap_or_default();
    for (target, &weight) in primitive.morph_targets().zip(weights) {
        let Some(moves) = target.positions().filter(|_| weight != 0.0) else { continue };
        for (position, by) in positions.iter_mut().zip(buffers.numbers::<3>(&moves)?) {
            *position = std::array::from_fn(|i| position[i] + f64::from(weight) * f64::from(by[i]));
        }
    }
    Ok(Some(positions))
}

/// How a primitive's vertices come into the scene.
pub(super) enum Pose {
    /// As its node.
    Node(Matrix),
    /// As joints: the transform of each vertex.
    Skin(Vec<Matrix>),
}

impl Pose {
    /// The pose of a primitive of so many vertices. A skin overrides the transform of its node.
    ///
    /// # Errors
    /// Accessors that do not fit, joints that are not in the scene.
    pub(super) fn of(
        buffers: &Buffers,
        primitive: &Primitive<'_>,
        placed: &Placed<'_>,
        count: usize,
    ) -> Result<Self> {
        let skin = placed.node.as_ref().and_then(Node::skin);
        let (Some(skin), Some(nodes)) = (skin, &placed.nodes) else {
            return Ok(Self::Node(placed.matrix));
        };
        let bound = match skin.inverse_bind_matrices() {
            Some(accessor) => buffers.numbers::<16>(&accessor)?,
            None => Vec::new(),
        };
        let mut joints = Vec::new();
        for (k, joint) in skin.joints().enumerate() {
            let node = nodes.get(&joint.index()).ok_or_else(|| {
                Error::new(format_args!("joint {} of its skin is not in the scene", joint.index()))
            })?;
            joints.push(match bound.get(k) {
                Some(inverse) => {
                    let columns: &[[f32; 4]] = inverse.as_chunks().0;
                    product(node, &std::array::from_fn(|i| columns[i].map(f64::from)))
                }
                None => *node,
            });
        }
        let mut sums = vec![([[0.0; 4]; 4], 0.0); count];
        for set in 0.. {
            let accessors =
                primitive.get(&Semantic::Joints(set)).zip(primitive.get(&Semantic::Weights(set)));
            let Some((which, weights)) = accessors else { break };
            let which = buffers.numbers::<4>(&which)?;
            let weights = buffers.numbers::<4>(&weights)?;
            for (((sum, total), which), weights) in sums.iter_mut().zip(which).zip(weights) {
                for (joint, weight) in which.into_iter().zip(weights) {
                    let weight = f64::from(weight);
                    let Some(joint) = joints.get(joint as usize).filter(|_| weight > 0.0) else {
                        continue;
                    };
                    for (to, from) in sum.as_flattened_mut().iter_mut().zip(joint.as_flattened()) {
                        *to += weight * from;
                    }
                    *total += weight;
                }
            }
        }
        let matrix = |(mut sum, total): (Matrix, f64)| {
            if total > 0.0 {
                sum.as_flattened_mut().iter_mut().for_each(|entry| *entry /= total);
                sum
            } else {
                // What no joint holds stays with the first.
                joints.first().copied().unwrap_or(placed.matrix)
            }
        };
        Ok(Self::Skin(sums.into_iter().map(matrix).collect()))
    }

    /// Where a vertex lies in the scene.
    pub(super) fn place(&self, vertex: usize, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let matrix = match self {
            Self::Node(matrix) => Some(matrix),
            Self::Skin(matrices) => matrices.get(vertex),
        };
        let [x, y, z, _] = transform(matrix.unwrap_or(&IDENTITY), [x, y, z, 1.0]);
        [x, y, z]
    }

    /// Whether it turns inside out.
    pub(super) fn mirrors(&self) -> bool {
        match self {
            Self::Node(matrix) => mirrors(matrix),
            Self::Skin(matrices) => matrices.first().is_some_and(mirrors),
        }
    }
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    b.map(|column| transform(a, column))
}

fn transform(matrix: &Matrix, v: [f64; 4]) -> [f64; 4] {
    std::array::from_fn(|i| (0..4).map(|k| matrix[k][i] * v[k]).sum())
}

/// Whether a transform turns inside out.
fn mirrors([a, b, c, _]: &Matrix) -> bool {
    let cofactor = |i: usize, j: usize| b[i] * c[j] - b[j] * c[i];
    a[0] * cofactor(1, 2) + a[1] * cofactor(2, 0) + a[2] * cofactor(0, 1) < 0.0
}
