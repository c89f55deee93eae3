/**
 * The page in `detect.js`'s frame: runs the face mesh, and nothing else.
 *
 * `window.look` is a promise of a function that gives the meshes of all faces in a canvas, as points
 * in units of its width and height.
 */

const VENDOR = 'vendor/face_mesh/';
const MOST_FACES = 8;

Object.assign(window, { look: load() });

async function load() {
  // The mesh reports some failures nowhere but here, and others by an alert.
  /** @type {Promise<never>} */
  const failure = new Promise((_, reject) => {
    addEventListener('error', (event) => reject(reason(event)), true);
    addEventListener('unhandledrejection', (event) => reject(event.reason));
    window.alert = (message) => reject(new Error(message));
  });
  failure.catch(() => {});
  return Promise.race([start(failure), failure]);
}

/** @param {Promise<never>} failure */
async function start(failure) {
  await new Promise((resolve) => {
    const script = document.createElement('script');
    script.src = `${VENDOR}face_mesh.js`;
    script.addEventListener('load', resolve);
    document.head.append(script);
  });
  // @ts-ignore: defined by the script
  const mesh = new FaceMesh({ locateFile: (/** @type {string} */ file) => VENDOR + file });
  mesh.setOptions({
    maxNumFaces: MOST_FACES,
    // The better of its two models for eyes and lips.
    refineLandmarks: true,
    // Not among the package's types. Without it models run as shaders, which takes seconds to
    // compile where there is no GPU, and gives other results on every GPU.
    useCpuInference: true,
  });

  /** @type {{ x: number, y: number }[][]} */
  let found = [];
  mesh.onResults((/** @type {any} */ results) => {
    found = results.multiFaceLandmarks;
  });
  const blank = document.createElement('canvas');
  blank.width = blank.height = 64;
  const send = (/** @type {HTMLCanvasElement} */ image) => Promise.race([mesh.send({ image }), failure]);

  await mesh.initialize();
  return async (/** @type {HTMLCanvasElement} */ picture) => {
    // The mesh takes pictures for a film's and looks for faces where they were. A picture without
    // makes it forget them, ten times faster than its `reset`.
    if (found.length > 0) await send(blank);
    await send(picture);
    return found;
  };
}

/** @param {ErrorEvent | Event} event */
function reason(event) {
  const { target } = event;
  if (target instanceof HTMLScriptElement) return new Error(`${target.src} is missing`);
  return new Error(event instanceof ErrorEvent ? (event.error?.message ?? event.message) : 'unknown');
}
