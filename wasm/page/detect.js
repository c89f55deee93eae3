/**
 * Finds a face's landmarks with MediaPipe's face mesh, which lies in `vendor/face_mesh` and is
 * loaded by the first call. The picture stays on this computer.
 */

/** @typedef {ImageBitmap | HTMLCanvasElement | OffscreenCanvas} Picture */
/** @typedef {{ x: number, y: number }} Point */
/** @typedef {{ x: number, y: number, side: number }} Square a part of a picture, in its pixels */
/** @typedef {(picture: HTMLCanvasElement) => Promise<Point[][]>} Look see `detect-frame.js` */

/**
 * Landmarks as points of the mesh, or as the mean of two, the left the mirror image of the right:
 * those nearest to the template's landmarks on renderings of 61 faces, or as near there and nearer
 * on photos.
 *
 * @type {Record<string, number[]>}
 */
const MESH_POINTS = {
  'right.eyebrow.bend.lower': [224],
  'right.eyebrow.inner_lower': [55],
  'left.eyebrow.inner_lower': [285],
  'left.eyebrow.bend.lower': [444],
  'right.eye.corner_outer': [33],
  'right.eye.corner_inner': [155],
  'left.eye.corner_inner': [382],
  'left.eye.corner_outer': [263],
  'right.nose.wing.tip': [98],
  'center.nose.tip': [1, 4],
  'left.nose.wing.tip': [327],
  'right.lips.corner': [61],
  'center.lips.upper.outer': [0],
  'left.lips.corner': [291],
  'center.lips.lower.outer': [17],
  'center.chin.tip': [175],
};

/** Parts of a photo are searched in views of this many pixels, at most four by four side by side. */
const SEARCH_VIEW = 256;
/** The face found is measured in a view of this many pixels: the mesh scales it to 192 or so. */
const FACE_VIEW = 512;
/** That view is this many times as large as the face. */
const MARGIN = 2;
/** Parts of a photo with fewer pixels across are not searched: their faces are too small to fit. */
const SMALLEST_PART = 192;

/** @type {Promise<Look> | null} */
let detector = null;
/** @type {Promise<unknown>} the call before, as the mesh takes one picture at a time */
let previous = Promise.resolve();

/**
 * The landmarks of the largest face of a picture, in its pixels (centres at whole numbers), or
 * `null` if there is no face.
 *
 * @param {Picture} picture
 * @returns {Promise<{ name: string, x: number, y: number }[] | null>}
 * @throws {Error} with one line to show, if the detector does not load or breaks
 */
export async function detect(picture) {
  const result = previous.then(async () => {
    detector ??= load();
    return landmarks(picture, await detector);
  });
  previous = result.catch(() => {});
  return result;
}

/** @param {Picture} picture @param {Look} look */
async function landmarks(picture, look) {
  const face = await search(picture, look);
  if (!face) return null;
  // Now with the face in the middle and of a good size, however small it is in the photo.
  const side = MARGIN * face.size;
  const around = { x: face.x - side / 2, y: face.y - side / 2, side };
  const mesh = largest(await see(picture, around, FACE_VIEW, look));
  if (!mesh) return null;
  return Object.entries(MESH_POINTS).map(([name, indices]) => ({
    name,
    x: mean(indices.map((i) => mesh[i].x)) - 0.5,
    y: mean(indices.map((i) => mesh[i].y)) - 0.5,
  }));
}

/**
 * Where the largest face is, or nothing.
 *
 * Faces below a seventh of a view are overlooked, so if there is none in the whole picture, its
 * parts are searched: overlapping squares of half, then a quarter its size.
 *
 * @param {Picture} picture @param {Look} look
 */
async function search(picture, look) {
  const whole = Math.max(picture.width, picture.height);
  const scale = Math.min(1, (4 * SEARCH_VIEW) / whole);
  const small = shrunk(picture, scale); // Once, as shrinking a large photo takes longer than a look.
  for (const side of [whole, whole / 2, whole / 4]) {
    if (side < whole && side < SMALLEST_PART) break;
    const meshes = [];
    for (const y of starts(small.height, scale * side)) {
      for (const x of starts(small.width, scale * side)) {
        meshes.push(...(await see(small, { x, y, side: scale * side }, SEARCH_VIEW, look)));
      }
    }
    const mesh = largest(meshes);
    if (mesh) {
      const { x, y, size } = extent(mesh);
      return { x: x / scale, y: y / scale, size: size / scale };
    }
  }
  return null;
}

/**
 * Where parts begin that cover a length and overlap by half or more.
 *
 * @param {number} length @param {number} side
 */
function starts(length, side) {
  const steps = Math.max(0, Math.ceil((length - side) / (side / 2)));
  if (steps === 0) return [(length - side) / 2];
  return Array.from({ length: steps + 1 }, (_, i) => (i * (length - side)) / steps);
}

/**
 * The meshes of the faces in a part of a picture, in the picture's coordinates: pixels' corners are
 * at whole numbers.
 *
 * @param {Picture} picture @param {Square} part @param {number} pixels @param {Look} look
 */
async function see(picture, { x, y, side }, pixels, look) {
  const { canvas, context } = blank(pixels, pixels);
  context.drawImage(picture, x, y, side, side, 0, 0, pixels, pixels);
  const meshes = await look(canvas);
  return meshes.map((mesh) => mesh.map((p) => ({ x: x + side * p.x, y: y + side * p.y })));
}

/** @param {Picture} picture @param {number} scale */
function shrunk(picture, scale) {
  const width = Math.ceil(scale * picture.width);
  const height = Math.ceil(scale * picture.height);
  const { canvas, context } = blank(width, height);
  context.drawImage(picture, 0, 0, scale * picture.width, scale * picture.height);
  return canvas;
}

/**
 * A black canvas: black is what lies beyond a picture's edges.
 *
 * @param {number} width @param {number} height
 */
function blank(width, height) {
  const canvas = document.createElement('canvas');
  Object.assign(canvas, { width, height });
  const context = canvas.getContext('2d');
  if (!context) throw new Error('This browser gives no canvas to draw on.');
  context.fillRect(0, 0, width, height);
  context.imageSmoothingQuality = 'high';
  return { canvas, context };
}

/** @param {Point[][]} meshes @returns {Point[] | undefined} */
function largest(meshes) {
  return [...meshes].sort((a, b) => extent(b).size - extent(a).size)[0];
}

/** A mesh's centre and the longer side of its box. @param {Point[]} mesh */
function extent(mesh) {
  const [xs, ys] = [mesh.map((p) => p.x), mesh.map((p) => p.y)];
  const [left, right] = [Math.min(...xs), Math.max(...xs)];
  const [top, bottom] = [Math.min(...ys), Math.max(...ys)];
  return {
    x: (left + right) / 2,
    y: (top + bottom) / 2,
    size: Math.max(right - left, bottom - top),
  };
}

/** @param {number[]} values */
function mean(values) {
  return values.reduce((sum, value) => sum + value, 0) / values.length;
}

/**
 * Loads the mesh in a frame of its own: it compiles code from strings, which this page's policy
 * forbids and should go on forbidding.
 *
 * @returns {Promise<Look>}
 */
async function load() {
  const frame = document.createElement('iframe');
  frame.hidden = true;
  frame.src = new URL('detect-frame.html', import.meta.url).href;
  /** @param {any} error of the frame, whose errors are no `Error`s of this page */
  const fail = (error) => {
    frame.remove();
    detector = null; // The next call tries again.
    const reason = String(error?.message ?? error).split('\n')[0];
    throw new Error(`The landmark detector failed: ${reason}`, { cause: error });
  };
  try {
    await new Promise((resolve) => {
      frame.addEventListener('load', resolve);
      document.body.append(frame);
    });
    // The frame is of this origin, so its functions can simply be called.
    const { look } = /** @type {any} */ (frame.contentWindow);
    if (!look) throw new Error('detect-frame.html is missing or blocked');
    const ready = await look;
    return (view) => ready(view).catch(fail);
  } catch (error) {
    return fail(error);
  }
}
