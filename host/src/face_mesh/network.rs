//! Convolutional networks: layers over tensors of rows, columns and channels, one picture at a time.
//!
//! Everything a layer relies on is checked when a network is made, so that running it cannot fail. Sums
//! have the order that is written here, whatever the vector width: the same bits on every machine.

/// What is wrong with a network.
type Fault = &'static str;

/// Output channels that are summed side by side. Chosen, not measured.
const CHANNELS: usize = 8;
/// Output columns that are summed side by side. Chosen, not measured.
const COLUMNS: usize = 4;
/// The most numbers a tensor may have.
const MOST: usize = 1 << 24;

/// What lies beyond the rim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Padding {
    /// As many zeros as make the output `⌈size/stride⌉` long, the odd one behind.
    Same,
    /// Nothing: windows stay within.
    Valid,
}

/// What a layer does; weights and other constants are among its inputs. Pairs are of rows and columns.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    /// Of pictures, weights `[out][row][column][in]` and biases.
    Convolution {
        padding: Padding,
        strides: [usize; 2],
    },
    /// Channel by channel, with weights `[row][column][channel]`.
    Depthwise {
        padding: Padding,
        strides: [usize; 2],
    },
    MaxPool {
        padding: Padding,
        strides: [usize; 2],
        window: [usize; 2],
    },
    /// `x`, or `αx` with an `α` of each channel where `x` is negative.
    Prelu,
    Relu,
    Add,
    /// By zeros, so many before and behind each dimension.
    Pad,
    /// Only the shape changes.
    Reshape,
    /// One behind the other; nothing is before that axis.
    Concatenation {
        axis: usize,
    },
    /// A constant that is stored in fewer bits.
    Dequantize,
}

/// A tensor as a file has it.
#[derive(Clone, Debug)]
pub(super) struct Tensor {
    /// Batch, rows, columns, channels.
    pub(super) shape: [usize; 4],
    /// How many of these the file has, the last.
    pub(super) rank: usize,
    pub(super) floats: Option<Vec<f32>>,
    pub(super) ints: Vec<i32>,
}

/// A layer as a file has it.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) kind: Kind,
    pub(super) inputs: Vec<usize>,
    pub(super) output: usize,
}

/// Rows, columns, channels.
type Shape = [usize; 3];

/// A window that goes over a picture.
#[derive(Clone, Copy, Debug)]
struct Window {
    size: [usize; 2],
    strides: [usize; 2],
    /// Zeros before and behind rows and columns.
    around: [[usize; 2]; 2],
}

/// A layer, ready to run.
#[derive(Debug)]
enum Layer {
    /// Weights are `[⌈out/CHANNELS⌉][row·column·in][CHANNELS]`.
    Convolution {
        window: Window,
        weights: Vec<[f32; CHANNELS]>,
        bias: Vec<[f32; CHANNELS]>,
    },
    /// Weights are `[row·column][channel]`.
    Depthwise {
        window: Window,
        weights: Vec<f32>,
        bias: Vec<f32>,
    },
    MaxPool(Window),
    Prelu(Vec<f32>),
    Relu,
    Add,
    /// Before and behind rows, columns and channels.
    Pad([[usize; 2]; 3]),
    Reshape,
    Concatenation,
}

/// A layer in its place.
#[derive(Debug)]
struct Step {
    layer: Layer,
    inputs: Vec<usize>,
    output: usize,
    /// Tensors that nothing needs after it.
    done: Vec<usize>,
}

/// A network.
#[derive(Debug)]
pub(super) struct Network {
    shapes: Vec<Shape>,
    steps: Vec<Step>,
    input: usize,
    outputs: Vec<usize>,
}

fn len([rows, columns, channels]: Shape) -> usize {
    rows * columns * channels
}

impl Network {
    /// Of a file's tensors and layers, which are in the order to run them.
    ///
    /// # Errors
    /// Shapes that do not fit each other, and tensors that are used before they are made.
    pub(super) fn new(
        mut tensors: Vec<Tensor>,
        nodes: Vec<Node>,
        input: usize,
        outputs: Vec<usize>,
    ) -> Result<Self, Fault> {
        if nodes
            .iter()
            .flat_map(|n| n.inputs.iter().chain([&n.output]))
            .any(|&at| at >= tensors.len())
        {
            return Err("a layer's tensor is missing");
        }
        for Node { kind, inputs, output } in &nodes {
            if let (Kind::Dequantize, [from]) = (kind, &inputs[..]) {
                if tensors[*output].shape != tensors[*from].shape {
                    return Err("a constant changes its shape");
                }
                let constant = tensors[*from].floats.clone();
                tensors[*output].floats = constant;
            }
        }
        let mut shapes = Vec::with_capacity(tensors.len());
        for Tensor { shape: [batch, rows, columns, channels], floats, .. } in &tensors {
            let constant = floats.as_ref().map_or(0, Vec::len);
            // Weights have their output channels first, and are no pictures.
            let shape = if constant > 0 { [1, 1, constant] } else { [*rows, *columns, *channels] };
            let count = shape.iter().try_fold(1_usize, |count, size| count.checked_mul(*size));
            if count.is_none_or(|count| count == 0 || count > MOST) || (constant == 0 && *batch > 1)
            {
                return Err("a tensor is empty, or larger than is reasonable");
            }
            shapes.push(shape);
        }
        let mut ready = vec![false; tensors.len()];
        *ready.get_mut(input).ok_or("the input is missing")? = true;
        let mut steps = Vec::new();
        for Node { kind, inputs, output } in nodes {
            if matches!(kind, Kind::Dequantize) {
                continue;
            }
            let (layer, pictures) = layer(kind, &inputs, output, &tensors, &shapes)?;
            if pictures.iter().any(|&at| !ready[at]) {
                return Err("a tensor is used before it is made");
            }
            ready[output] = true;
            steps.push(Step { layer, inputs: pictures, output, done: Vec::new() });
        }
        if outputs.iter().any(|&at| ready.get(at) != Some(&true)) {
            return Err("an output is not made");
        }
        let mut needed = vec![false; tensors.len()];
        for &output in &outputs {
            needed[output] = true;
        }
        for step in steps.iter_mut().rev() {
            for &at in &step.inputs {
                if !needed[at] {
                    needed[at] = true;
                    step.done.push(at);
                }
            }
        }
        Ok(Self { shapes, steps, input, outputs })
    }

    /// Rows, columns and channels of the input.
    pub(super) fn input_shape(&self) -> [usize; 3] {
        self.shapes[self.input]
    }

    /// Numbers of each output.
    pub(super) fn output_lengths(&self) -> Vec<usize> {
        self.outputs.iter().map(|&at| len(self.shapes[at])).collect()
    }

    /// The outputs for an input `[row][column][channel]`, which is cut or filled up with zeros if it is of
    /// another length.
    pub(super) fn run(&self, mut input: Vec<f32>) -> Vec<Vec<f32>> {
        input.resize(len(self.input_shape()), 0.0);
        let mut values = vec![Vec::new(); self.shapes.len()];
        values[self.input] = input;
        for Step { layer, inputs, output, done } in &self.steps {
            let first = inputs[0];
            let shapes = [self.shapes[first], self.shapes[*output]];
            // What is not needed any more may be changed in place.
            let own = |values: &mut Vec<Vec<f32>>| {
                if done.contains(&first) || first == *output {
                    std::mem::take(&mut values[first])
                } else {
                    values[first].clone()
                }
            };
            let made = match layer {
                Layer::Convolution { window, weights, bias } => {
                    convolve(&values[first], shapes, window, weights, bias)
                }
                Layer::Depthwise { window, weights, bias } => {
                    convolve_depthwise(&values[first], shapes, window, weights, bias)
                }
                Layer::MaxPool(window) => max_pool(&values[first], shapes, window),
                Layer::Pad(around) => pad(&values[first], shapes[0], *around, 0.0),
                Layer::Prelu(slopes) => {
                    let mut all = own(&mut values);
                    for pixel in all.chunks_exact_mut(slopes.len()) {
                        for (x, slope) in pixel.iter_mut().zip(slopes) {
                            *x = if *x >= 0.0 { *x } else { *x * slope };
                        }
                    }
                    all
                }
                Layer::Relu => {
                    let mut all = own(&mut values);
                    for x in &mut all {
                        *x = if *x > 0.0 { *x } else { 0.0 };
                    }
                    all
                }
                Layer::Add => {
                    let mut all = own(&mut values);
                    let other = if inputs[1] == first { all.clone() } else { Vec::new() };
                    let other = if other.is_empty() { &values[inputs[1]] } else { &other };
                    for (x, y) in all.iter_mut().zip(other) {
                        *x += y;
                    }
                    all
                }
                Layer::Reshape => own(&mut values),
                Layer::Concatenation => {
                    inputs.iter().flat_map(|&at| values[at].iter().copied()).collect()
                }
            };
            for &at in done {
                values[at] = Vec::new();
            }
            values[*output] = made;
        }
        self.outputs.iter().map(|&at| values[at].clone()).collect()
    }
}

/// A layer and the tensors it is about, of which there is at least one, checked.
fn layer(
    kind: Kind,
    inputs: &[usize],
    output: usize,
    tensors: &[Tensor],
    shapes: &[Shape],
) -> Result<(Layer, Vec<usize>), Fault> {
    const WRONG: Fault = "the shapes of a layer's tensors do not fit";
    let floats = |at: usize| tensors[at].floats.as_ref().ok_or("a layer's weights are missing");
    let fits = |holds: bool| if holds { Ok(()) } else { Err(WRONG) };
    let first = *inputs.first().ok_or("a layer has no input")?;
    let (from, to) = (shapes[first], shapes[output]);
    let layer = match (kind, inputs) {
        (Kind::Convolution { padding, strides }, &[_, weights, bias]) => {
            let [out, rows, columns, channels] = tensors[weights].shape;
            let window = Window::new([rows, columns], strides, padding, from, to)?;
            let (weights, bias) = (floats(weights)?, floats(bias)?);
            let taps = rows * columns * channels;
            fits(channels == from[2] && out == to[2] && weights.len() == out * taps)?;
            fits(bias.len() == out)?;
            let lane = |o: usize, at: usize| weights.get(o * taps + at).copied().unwrap_or(0.0);
            let weights = (0..out.div_ceil(CHANNELS) * taps)
                .map(|i| std::array::from_fn(|l| lane(i / taps * CHANNELS + l, i % taps)))
                .collect();
            let bias = (0..out.div_ceil(CHANNELS))
                .map(|block| {
                    std::array::from_fn(|l| bias.get(block * CHANNELS + l).copied().unwrap_or(0.0))
                })
                .collect();
            Layer::Convolution { window, weights, bias }
        }
        (Kind::Depthwise { padding, strides }, &[_, weights, bias]) => {
            let [_, rows, columns, channels] = tensors[weights].shape;
            let window = Window::new([rows, columns], strides, padding, from, to)?;
            let (weights, bias) = (floats(weights)?.clone(), floats(bias)?.clone());
            fits(channels == from[2] && channels == to[2] && bias.len() == channels)?;
            fits(weights.len() == rows * columns * channels)?;
            Layer::Depthwise { window, weights, bias }
        }
        (Kind::MaxPool { padding, strides, window }, [_]) => {
            fits(from[2] == to[2])?;
            Layer::MaxPool(Window::new(window, strides, padding, from, to)?)
        }
        (Kind::Prelu, &[_, slopes]) => {
            let slopes = floats(slopes)?.clone();
            fits(from == to && slopes.len() == from[2])?;
            Layer::Prelu(slopes)
        }
        (Kind::Relu, [_]) => {
            fits(from == to)?;
            Layer::Relu
        }
        (Kind::Add, &[_, other]) => {
            fits(from == to && shapes[other] == to && tensors[other].floats.is_none())?;
            return Ok((Layer::Add, vec![first, other]));
        }
        (Kind::Pad, &[_, around]) => {
            let sizes: Result<Vec<usize>, _> =
                tensors[around].ints.iter().map(|&x| usize::try_from(x)).collect();
            let sizes = sizes.map_err(|_| WRONG)?;
            let (pairs, _) = sizes.as_chunks::<2>();
            let free = 4_usize.checked_sub(pairs.len()).ok_or(WRONG)?;
            let pair = |axis: usize| axis.checked_sub(free).map_or([0; 2], |i| pairs[i]);
            let around = [pair(1), pair(2), pair(3)];
            let grown: Shape = std::array::from_fn(|i| {
                from[i].saturating_add(around[i][0]).saturating_add(around[i][1])
            });
            fits(pair(0) == [0; 2] && grown == to)?;
            Layer::Pad(around)
        }
        (Kind::Reshape, _) => {
            fits(len(from) == len(to))?;
            Layer::Reshape
        }
        (Kind::Concatenation { axis }, _) => {
            let axis = axis + 4_usize.checked_sub(tensors[output].rank).ok_or(WRONG)?;
            let sum: usize = inputs.iter().map(|&at| len(shapes[at])).sum();
            fits(tensors[output].shape.iter().take(axis).all(|&size| size == 1))?;
            fits(sum == len(to) && inputs.iter().all(|&at| tensors[at].floats.is_none()))?;
            return Ok((Layer::Concatenation, inputs.to_vec()));
        }
        _ => return Err("a layer has another number of inputs than its kind"),
    };
    Ok((layer, vec![first]))
}

impl Window {
    /// One that makes a picture of one size from one of another.
    fn new(
        size: [usize; 2],
        strides: [usize; 2],
        padding: Padding,
        from: Shape,
        to: Shape,
    ) -> Result<Self, Fault> {
        const WRONG: Fault = "a window does not fit its picture";
        let mut around = [[0; 2]; 2];
        for axis in 0..2 {
            let (size, stride) = (size[axis], strides[axis]);
            if size == 0 || stride == 0 || size > MOST || stride > MOST {
                return Err(WRONG);
            }
            let needed = (to[axis] - 1) * stride + size;
            let missing = needed.saturating_sub(from[axis]);
            let expected = match padding {
                Padding::Same => from[axis].div_ceil(stride),
                Padding::Valid if missing > 0 => return Err(WRONG),
                Padding::Valid => (from[axis] - size) / stride + 1,
            };
            if expected != to[axis] {
                return Err(WRONG);
            }
            around[axis] = [missing / 2, missing - missing / 2];
        }
        Ok(Self { size, strides, around })
    }

    /// A picture with what is around it; its own, if that is nothing.
    fn grown<'p>(
        &self,
        picture: &'p [f32],
        shape: Shape,
        by: f32,
    ) -> (std::borrow::Cow<'p, [f32]>, Shape) {
        let [rows, columns] = self.around;
        if self.around == [[0; 2]; 2] {
            return (picture.into(), shape);
        }
        let around = [rows, columns, [0; 2]];
        let grown = std::array::from_fn(|i| shape[i] + around[i][0] + around[i][1]);
        (pad(picture, shape, around, by).into(), grown)
    }
}

/// A picture in the midst of a larger one.
fn pad(picture: &[f32], shape: Shape, around: [[usize; 2]; 3], by: f32) -> Vec<f32> {
    let [_, columns, channels] = std::array::from_fn(|i| shape[i] + around[i][0] + around[i][1]);
    let rows = shape[0] + around[0][0] + around[0][1];
    let mut grown = vec![by; rows * columns * channels];
    for (row, to) in picture
        .chunks_exact(shape[1] * shape[2])
        .zip(grown.chunks_exact_mut(columns * channels).skip(around[0][0]))
    {
        for (pixel, to) in
            row.chunks_exact(shape[2]).zip(to.chunks_exact_mut(channels).skip(around[1][0]))
        {
            to[around[2][0]..][..shape[2]].copy_from_slice(pixel);
        }
    }
    grown
}

fn convolve(
    picture: &[f32],
    [from, to]: [Shape; 2],
    window: &Window,
    weights: &[[f32; CHANNELS]],
    bias: &[[f32; CHANNELS]],
) -> Vec<f32> {
    let (picture, grown) = window.grown(picture, from, 0.0);
    let mut made = vec![0.0; len(to)];
    for (y, row) in made.chunks_exact_mut(to[1] * to[2]).enumerate() {
        let mut x = 0;
        while x + COLUMNS <= to[1] {
            convolve_pixels::<COLUMNS>(
                &picture,
                grown,
                window,
                (weights, bias),
                [y, x],
                row,
                to[2],
            );
            x += COLUMNS;
        }
        while x < to[1] {
            convolve_pixels::<1>(&picture, grown, window, (weights, bias), [y, x], row, to[2]);
            x += 1;
        }
    }
    made
}

/// Some pixels side by side.
#[inline(always)]
fn convolve_pixels<const N: usize>(
    picture: &[f32],
    [_, columns, channels]: Shape,
    window: &Window,
    (weights, bias): (&[[f32; CHANNELS]], &[[f32; CHANNELS]]),
    [y, x]: [usize; 2],
    row: &mut [f32],
    out: usize,
) {
    let [rows, taps] = [window.size[0], window.size[1] * channels];
    for (block, (weights, bias)) in weights.chunks_exact(rows * taps).zip(bias).enumerate() {
        let mut sums = [*bias; N];
        for (tap_row, weights) in weights.chunks_exact(taps).enumerate() {
            let line = (y * window.strides[0] + tap_row) * columns;
            let at: [&[f32]; N] = std::array::from_fn(|i| {
                &picture[(line + (x + i) * window.strides[1]) * channels..][..taps]
            });
            for (tap, weights) in weights.iter().enumerate() {
                for (sums, at) in sums.iter_mut().zip(at) {
                    let value = at[tap];
                    for (sum, weight) in sums.iter_mut().zip(weights) {
                        *sum += value * weight;
                    }
                }
            }
        }
        let count = CHANNELS.min(out - block * CHANNELS);
        for (i, sums) in sums.iter().enumerate() {
            row[(x + i) * out + block * CHANNELS..][..count].copy_from_slice(&sums[..count]);
        }
    }
}

fn convolve_depthwise(
    picture: &[f32],
    [from, to]: [Shape; 2],
    window: &Window,
    weights: &[f32],
    bias: &[f32],
) -> Vec<f32> {
    let (picture, [_, columns, channels]) = window.grown(picture, from, 0.0);
    let mut made = vec![0.0; len(to)];
    for (i, pixel) in made.chunks_exact_mut(channels).enumerate() {
        let [y, x] = [i / to[1] * window.strides[0], i % to[1] * window.strides[1]];
        pixel.copy_from_slice(bias);
        for (tap, weights) in weights.chunks_exact(channels).enumerate() {
            let [dy, dx] = [tap / window.size[1], tap % window.size[1]];
            let values = &picture[((y + dy) * columns + x + dx) * channels..][..channels];
            for ((sum, value), weight) in pixel.iter_mut().zip(values).zip(weights) {
                *sum += value * weight;
            }
        }
    }
    made
}

fn max_pool(picture: &[f32], [from, to]: [Shape; 2], window: &Window) -> Vec<f32> {
    let (picture, [_, columns, channels]) = window.grown(picture, from, f32::NEG_INFINITY);
    let mut made = vec![f32::NEG_INFINITY; len(to)];
    for (i, pixel) in made.chunks_exact_mut(channels).enumerate() {
        let [y, x] = [i / to[1] * window.strides[0], i % to[1] * window.strides[1]];
        for tap in 0..window.size[0] * window.size[1] {
            let [dy, dx] = [tap / window.size[1], tap % window.size[1]];
            let values = &picture[((y + dy) * columns + x + dx) * channels..][..channels];
            for (most, value) in pixel.iter_mut().zip(values) {
                *most = if *value > *most { *value } else { *most };
            }
        }
    }
    made
}

#[cfg(test)]
mod tests {
    use super::*;
    use onescan_core::rng::Rng;

    fn constant(shape: [usize; 4], rng: &mut Rng) -> Tensor {
        let count = shape.iter().product();
        let floats = Some((0..count).map(|_| rng.normal() as f32).collect());
        Tensor { shape, rank: 4, floats, ints: Vec::new() }
    }

    fn picture([rows, columns, channels]: Shape) -> Tensor {
        Tensor { shape: [1, rows, columns, channels], rank: 4, floats: None, ints: Vec::new() }
    }

    /// A network of one layer.
    fn single(
        kind: Kind,
        from: Shape,
        to: Shape,
        constants: Vec<Tensor>,
    ) -> Result<Network, Fault> {
        let count = constants.len();
        let tensors = [vec![picture(from), picture(to)], constants].concat();
        let inputs = std::iter::once(0).chain(2..2 + count).collect();
        Network::new(tensors, vec![Node { kind, inputs, output: 1 }], 0, vec![1])
    }

    /// A convolution by its definition, in double precision; pictures are 0 beyond their rims.
    fn by_definition(
        picture: &[f32],
        [from, to]: [Shape; 2],
        (weights, bias): (&Tensor, &Tensor),
        strides: [usize; 2],
        depthwise: bool,
    ) -> Vec<f64> {
        let [_, rows, columns, _] = weights.shape;
        let (weights, bias) = (weights.floats.as_ref().unwrap(), bias.floats.as_ref().unwrap());
        let before = |axis: usize, size: usize| {
            ((to[axis] - 1) * strides[axis] + size).saturating_sub(from[axis]) / 2
        };
        let at = |y: usize, x: usize, c: usize| {
            let [y, x] = [y.wrapping_sub(before(0, rows)), x.wrapping_sub(before(1, columns))];
            let inside = y < from[0] && x < from[1];
            if inside { f64::from(picture[(y * from[1] + x) * from[2] + c]) } else { 0.0 }
        };
        let mut made = Vec::new();
        for i in 0..len(to) {
            let [y, x, o] = [i / to[2] / to[1], i / to[2] % to[1], i % to[2]];
            let mut sum = f64::from(bias[o]);
            for (tap, c) in (0..rows * columns).flat_map(|tap| (0..from[2]).map(move |c| (tap, c)))
            {
                let value = at(y * strides[0] + tap / columns, x * strides[1] + tap % columns, c);
                let weight = match depthwise {
                    true if c == o => weights[tap * from[2] + c],
                    true => 0.0,
                    false => weights[(o * rows * columns + tap) * from[2] + c],
                };
                sum += value * f64::from(weight);
            }
            made.push(sum);
        }
        made
    }

    #[test]
    fn convolutions_are_what_they_are_by_definition() {
        let mut rng = Rng::new(5, 0);
        for (from, to, window, strides, padding) in [
            ([7, 9, 3], [7, 9, 10], [3, 3], [1, 1], Padding::Same),
            ([7, 9, 3], [4, 5, 16], [5, 5], [2, 2], Padding::Same),
            ([8, 8, 2], [4, 4, 5], [3, 3], [2, 2], Padding::Same),
            ([6, 6, 8], [1, 1, 9], [6, 6], [1, 1], Padding::Valid),
            ([5, 4, 6], [5, 4, 6], [1, 1], [1, 1], Padding::Same),
        ] {
            let input: Vec<f32> = (0..len(from)).map(|_| rng.normal() as f32).collect();
            for depthwise in [false, true] {
                let to = if depthwise { [to[0], to[1], from[2]] } else { to };
                let first = if depthwise { 1 } else { to[2] };
                let weights = constant([first, window[0], window[1], from[2]], &mut rng);
                let bias = constant([1, 1, 1, to[2]], &mut rng);
                let kind = if depthwise {
                    Kind::Depthwise { padding, strides }
                } else {
                    Kind::Convolution { padding, strides }
                };
                let expected =
                    by_definition(&input, [from, to], (&weights, &bias), strides, depthwise);
                let network = single(kind, from, to, vec![weights, bias]).unwrap();
                let made = &network.run(input.clone())[0];
                assert_eq!(made.len(), expected.len());
                for (made, expected) in made.iter().zip(expected) {
                    assert!((f64::from(*made) - expected).abs() < 1e-4, "{made} {expected}");
                }
            }
        }
    }

    #[test]
    fn other_layers_do_what_they_say() {
        let run = |kind, from, to, constants, input: &[f32]| {
            single(kind, from, to, constants).unwrap().run(input.to_vec()).remove(0)
        };
        let slopes = Tensor { floats: Some(vec![0.5, 2.0]), ..picture([1, 1, 2]) };
        let input = [1.0, -2.0, -3.0, 4.0];
        assert_eq!(
            run(Kind::Prelu, [1, 2, 2], [1, 2, 2], vec![slopes], &input),
            [1.0, -4.0, -1.5, 4.0]
        );
        assert_eq!(run(Kind::Relu, [1, 2, 2], [1, 2, 2], vec![], &input), [1.0, 0.0, 0.0, 4.0]);
        let pool = Kind::MaxPool { padding: Padding::Same, strides: [2, 2], window: [2, 2] };
        let three = [1.0, 5.0, -3.0, 2.0, 0.0, -1.0, -7.0, -8.0, -9.0];
        assert_eq!(run(pool, [3, 3, 1], [2, 2, 1], vec![], &three), [5.0, -1.0, -7.0, -9.0]);
        let around =
            Tensor { ints: vec![0, 0, 0, 1, 1, 0, 0, 1], floats: None, ..picture([1, 4, 2]) };
        assert_eq!(
            run(Kind::Pad, [1, 1, 2], [2, 2, 3], vec![around], &[1.0, 2.0]),
            [0.0, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        );
    }

    #[test]
    fn sums_and_concatenations_take_two() {
        let node = |kind, inputs: &[usize], output| Node { kind, inputs: inputs.to_vec(), output };
        let tensors =
            vec![picture([1, 2, 1]), picture([1, 2, 1]), picture([1, 2, 1]), picture([4, 1, 1])];
        // x, its rectified, their sum, and both one behind the other.
        let nodes = vec![
            node(Kind::Relu, &[0], 1),
            node(Kind::Add, &[0, 1], 2),
            node(Kind::Concatenation { axis: 1 }, &[2, 1], 3),
        ];
        let network = Network::new(tensors, nodes, 0, vec![3]).unwrap();
        assert_eq!(network.run(vec![-1.0, 3.0]), [[-1.0, 6.0, 0.0, 3.0]]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut rng = Rng::new(5, 1);
        let convolution = Kind::Convolution { padding: Padding::Same, strides: [1, 1] };
        let mut parts = || (constant([4, 3, 3, 2], &mut rng), constant([1, 1, 1, 4], &mut rng));
        let mut refused = |kind, from, to, change: fn(&mut Tensor)| {
            let (mut weights, bias) = parts();
            change(&mut weights);
            single(kind, from, to, vec![weights, bias]).is_err()
        };
        let good = |_: &mut Tensor| {};
        assert!(!refused(convolution, [5, 5, 2], [5, 5, 4], good));
        assert!(refused(convolution, [5, 5, 3], [5, 5, 4], good));
        assert!(refused(convolution, [5, 5, 2], [4, 5, 4], good));
        assert!(refused(convolution, [5, 5, 2], [5, 5, 9], good));
        assert!(refused(convolution, [5, 5, 2], [5, 5, 4], |w| w.floats = None));
        assert!(refused(convolution, [5, 5, 2], [5, 5, 4], |w| w.shape[1] = 2));
        assert!(refused(Kind::Relu, [5, 5, 2], [5, 5, 4], good));
        let unmade = Node { kind: Kind::Relu, inputs: vec![1], output: 1 };
        let tensors = vec![picture([1, 1, 1]), picture([1, 1, 1])];
        assert!(Network::new(tensors.clone(), vec![unmade.clone()], 0, vec![1]).is_err());
        assert!(Network::new(tensors.clone(), vec![], 0, vec![1]).is_err());
        let outside = Node { inputs: vec![2], ..unmade };
        assert!(Network::new(tensors, vec![outside], 0, vec![0]).is_err());
    }
}
