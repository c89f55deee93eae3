/** The page: what happens when. Computing is the worker's (../js), drawing the other files'. */

import { connect } from '../js/client.js';
import { scriptUrl } from '../js/trusted.js';
import { openCamera } from './camera.js';
import { drawTrace } from './chart.js';
import { button, context, element, save } from './dom.js';
import { Editor, copied } from './editor.js';
import { isFace, spoken, wanted } from './landmarks.js';
import { Shots } from './shots.js';
import { Sliders } from './sliders.js';
import { View } from './view.js';
import { zip } from './zip.js';

/** @typedef {import('./editor.js').Shot} Shot */

/** Landmarks a fit needs at least, in each photo. */
const FEWEST = 4;
/** Photos a fit takes at most. */
const MOST = 8;
/** What gzip files begin with. */
const GZIP = [0x1f, 0x8b];

const client = connect();
const editor = new Editor();
const view = new View(element('view', HTMLCanvasElement), client);
const sliders = new Sliders(element('sliders', HTMLDivElement), async (values) => {
  await client.set(values);
  view.draw();
});
const input = (/** @type {string} */ id) => element(id, HTMLInputElement);
const stage = element('stage', HTMLElement);
const strip = new Shots(element('shots', HTMLElement), (shot) => attempt(() => choose(shot)));

const state = {
  /** @type {import('../js/worker.js').ModelFacts | undefined} */
  model: undefined,
  modelName: '',
  /** The photos, all of one person, in the worker's order. @type {Shot[]} */
  shots: [],
  /** The one that is shown. @type {Shot | undefined} */
  shot: undefined,
  /** @type {'idle' | 'fitting' | 'paused'} */
  busy: 'idle',
  detecting: false,
  /** The last finished fit: its job, and what came of it. @type {{ job: any, result: any } | undefined} */
  fitted: undefined,
};

// ---- messages and buttons

/** @param {string} text @param {boolean} [wrong] */
function say(text, wrong = false) {
  const message = element('message', HTMLParagraphElement);
  message.textContent = text;
  message.classList.toggle('wrong', wrong);
}

/** Runs what a user asked for and says what went wrong. @param {() => unknown} action */
async function attempt(action) {
  try {
    await action();
  } catch (error) {
    say(error instanceof Error ? error.message : String(error), true);
  }
  refresh();
}

/** @param {string} id @param {() => unknown} action */
function on(id, action) {
  button(id).addEventListener('click', () => attempt(action));
}

/** Landmarks neither set nor said to be out of sight, in order. */
function missing() {
  const set = new Set(editor.points.map(({ name }) => name));
  return wanted(state.model?.landmarks ?? []).filter((name) => !set.has(name) && !state.shot?.skipped.has(name));
}

/** Whether a photo needs more landmarks. @param {Shot} shot */
const lacking = (shot) => shot.points.length < FEWEST;

/** Brings buttons, hints and the guide up to date. */
function refresh() {
  const { model, shots, shot, busy, detecting, fitted } = state;
  const hasPhoto = Boolean(shot);
  const idle = busy === 'idle' && !detecting;
  const names = model?.landmarks ?? [];
  const left = missing();
  const placing = hasPhoto && idle && left.length > 0;
  button('detect').disabled = !hasPhoto || !idle || !isFace(names);
  button('next-face').hidden = (shot?.faces?.length ?? 0) < 2;
  button('next-face').disabled = !idle;
  button('undo').disabled = !idle || !shot?.past.length;
  button('reset').disabled = !idle || !shot?.past.length || !shot.given;
  button('clear').disabled = !hasPhoto || !idle || editor.points.length + (shot?.skipped.size ?? 0) === 0;
  const ready = hasPhoto && !shots.some(lacking);
  button('fit').disabled = !model || !idle || !ready;
  button('fit').hidden = busy !== 'idle';
  button('add').disabled = !idle || shots.length >= MOST;
  button('add').hidden = !ready;
  button('remove').disabled = !idle;
  button('remove').hidden = shots.length < 2;
  element('shot-tools', HTMLElement).hidden = !ready && shots.length < 2;
  strip.show(shots, shot, { disabled: detecting, lacking });
  button('pause').hidden = button('cancel').hidden = busy === 'idle';
  button('pause').textContent = busy === 'paused' ? 'Resume' : 'Pause';
  button('verify').disabled = !idle || !fitted;
  for (const id of ['camera', 'file', 'model']) element(id, HTMLElement).toggleAttribute('disabled', !idle);
  element('drop', HTMLElement).hidden = hasPhoto;
  element('stage-tools', HTMLElement).hidden = !hasPhoto;
  stage.classList.toggle('filled', hasPhoto);
  const byHand = element('by-hand', HTMLElement);
  const begins = placing && byHand.hidden;
  byHand.hidden = !placing;
  if (begins) byHand.scrollIntoView({ block: 'nearest' });
  editor.placing(placing);
  editor.lock(busy !== 'idle');
  editor.show(busy === 'idle' && input('show-points').checked);
  if (placing) guide(left[0]);
}

let guided = '';

/** Shows where a landmark is on the model. @param {string} name */
async function guide(name) {
  if (guided === name) return;
  guided = name;
  element('next', HTMLElement).textContent = spoken(name);
  const canvas = element('guide', HTMLCanvasElement);
  const camera = { ...view.camera, width: canvas.width, height: canvas.height, yaw: 0, pitch: 0 };
  const [picture, [x, y]] = await Promise.all([client.drawMean(camera), client.locate(name, camera)]);
  const draw = context(canvas);
  draw.drawImage(picture, 0, 0);
  picture.close();
  draw.beginPath();
  draw.arc(x + 0.5, y + 0.5, 5, 0, 2 * Math.PI);
  draw.fillStyle = '#ffd23f';
  draw.fill();
  draw.stroke();
}

// ---- the model

/** @param {string} name @param {Uint8Array} bytes */
async function openModel(name, bytes) {
  if (GZIP.every((byte, i) => bytes[i] === byte)) {
    const stream = new Blob([/** @type {BlobPart} */ (bytes)]).stream();
    bytes = new Uint8Array(await new Response(stream.pipeThrough(new DecompressionStream('gzip'))).arrayBuffer());
    name = name.replace(/\.gz$/, '');
  }
  const model = await client.open(bytes).catch((error) => {
    throw new Error(`${name}: ${error.message}`);
  });
  const before = state.model;
  const sameLandmarks = model.landmarks.join() === before?.landmarks.join();
  Object.assign(state, { model, modelName: name, fitted: undefined });
  guided = '';
  // A photo may have been opened while the first model was on its way.
  if (before && !sameLandmarks) state.shots.forEach(startOver);
  const { vertices, shapeRank, albedoRank } = model;
  element('model-facts', HTMLElement).textContent =
    `${name}: ${vertices} vertices, ${shapeRank} shape and ${albedoRank} albedo components.`;
  showFace(await client.mean());
  element('numbers', HTMLElement).hidden = true;
  element('result', HTMLElement).hidden = false;
}

/** Resolves once the model that comes with the page is there, or its absence was said. @type {Promise<void>} */
let loading = Promise.resolve();

/** The model that comes with the page. */
async function loadModel() {
  const response = await fetch('face.3dmm.gz');
  if (!response.ok) throw new Error(`the face model could not be loaded (${response.status}); reload the page`);
  await openModel('face.3dmm.gz', new Uint8Array(await response.arrayBuffer()));
  // All is there: it may be kept for the days without a network.
  navigator.serviceWorker?.register(scriptUrl('sw.js')).catch(() => {});
}

input('model').addEventListener('change', () =>
  attempt(async () => {
    const file = input('model').files?.[0];
    if (!file) return;
    await openModel(file.name, new Uint8Array(await file.arrayBuffer()));
    say(`${file.name} is the model now.`);
  }),
);

// ---- the photo

/**
 * Opens a photo: the only one, or one more of the same person.
 * @param {string} name
 * @param {Uint8Array | ImageData} source
 * @param {boolean} [more]
 */
async function openPhoto(name, source, more = false) {
  if (state.busy !== 'idle') throw new Error('a fit is running; cancel it first');
  say('Reading the photo.');
  const photo = await (more ? client.addPhoto(source) : client.photo(source)).catch((error) => {
    throw new Error(`${name}: ${error.message}`);
  });
  if (!more) state.shots.splice(0).forEach(close);
  forget();
  const shot = { ...photo, name: unused(name), points: [], skipped: new Set(), past: [] };
  state.shots.push(shot);
  await choose(shot);
}

/** A photo's files are named like it, so that no two may be called the same. @param {string} name */
function unused(name) {
  let free = name;
  for (let i = 2; state.shots.some((shot) => shot.name === free); i += 1) {
    free = name.replace(/(\.\w+)?$/, `-${i}$1`);
  }
  return free;
}

/** Lays aside what was fitted to other photos than these. */
function forget() {
  if (state.fitted) client.mean().then(showFace);
  state.fitted = undefined;
  for (const shot of state.shots) editor.overlay(shot);
  for (const id of ['fitted-tools', 'live', 'numbers']) element(id, HTMLElement).hidden = true;
}

/** @param {Shot} shot */
function close(shot) {
  editor.overlay(shot);
  shot.picture.close();
}

/** Shows one of the photos. @param {Shot} shot */
async function choose(shot) {
  state.shot = shot;
  editor.open(shot);
  showMask();
  if (state.fitted) showNumbers();
  refresh();
  await client.watch(position());
  if (state.fitted && element('light', HTMLSelectElement).value === 'photo') await illuminate();
}

on('add', () => input('more').click());
on('remove', async () => {
  const { shot, shots } = state;
  if (!shot || shots.length < 2) return;
  const at = shots.indexOf(shot);
  await client.removePhoto(at);
  shots.splice(at, 1);
  forget();
  await choose(shots[Math.min(at, shots.length - 1)]);
  close(shot);
  say(`${shot.name} is removed.`);
});

/** @param {File} file @param {boolean} [more] */
async function openFile(file, more) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  // These two onescan decodes itself, to the same pixels everywhere; others are the browser's.
  const own = [[0x89, 0x50, 0x4e, 0x47], [0xff, 0xd8, 0xff]].some((magic) => magic.every((byte, i) => bytes[i] === byte));
  await openPhoto(file.name, own ? bytes : await pixels(file), more);
  await findLandmarks();
}

/** Pixels of a picture the browser can read. @param {File} file */
async function pixels(file) {
  const picture = await createImageBitmap(file).catch(() => {
    throw new Error(`${file.name}: not a picture this browser reads; give a PNG or JPEG`);
  });
  const canvas = new OffscreenCanvas(picture.width, picture.height);
  const draw = canvas.getContext('2d');
  if (!draw) throw new Error('this browser draws no canvas');
  draw.drawImage(picture, 0, 0);
  picture.close();
  return draw.getImageData(0, 0, canvas.width, canvas.height);
}

/** @param {string} file */
async function openSample(file) {
  const [photo, landmarks] = await Promise.all(
    [file, file.replace(/\.\w+$/, '.tlms')].map(async (name) => {
      const response = await fetch(`samples/${name}`);
      if (!response.ok) throw new Error(`${name} could not be loaded (${response.status})`);
      return response;
    }),
  );
  await openPhoto(file, new Uint8Array(await photo.arrayBuffer()));
  openLandmarks(file, await landmarks.text());
  say('The landmarks of this sample were set by hand. Press Fit.');
}

input('file').addEventListener('change', () =>
  attempt(async () => {
    const file = input('file').files?.[0];
    if (file) await openFile(file);
    input('file').value = '';
  }),
);
input('more').addEventListener('change', () =>
  attempt(async () => {
    const files = [...(input('more').files ?? [])].slice(0, MOST - state.shots.length);
    input('more').value = '';
    for (const file of files) await openFile(file, true);
  }),
);
for (const link of document.querySelectorAll('[data-sample]')) {
  link.addEventListener('click', () => attempt(() => openSample(link.getAttribute('data-sample') ?? '')));
}
on('camera', async () => {
  const picture = await openCamera();
  if (!picture) return;
  await openPhoto('camera.png', picture);
  await findLandmarks();
});

for (const name of ['dragover', 'dragleave', 'drop']) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    stage.classList.toggle('over', name === 'dragover');
  });
}
document.addEventListener('drop', (event) => attempt(() => take(event.dataTransfer?.files[0])));
document.addEventListener('paste', (event) => attempt(() => take(event.clipboardData?.files[0])));

/** A file dropped or pasted: a model, the landmarks of the photo that is shown, or a photo. @param {File} [file] */
async function take(file) {
  if (!file) return;
  if (/\.3dmm(\.gz)?$/.test(file.name)) await openModel(file.name, new Uint8Array(await file.arrayBuffer()));
  else if (file.name.endsWith('.tlms')) openLandmarks(file.name, await file.text());
  else await openFile(file);
}

/** The landmarks of the photo that is shown, as a file has them. @param {string} name @param {string} text */
function openLandmarks(name, text) {
  const { shot } = state;
  if (!shot) throw new Error(`${name}: open the photo first`);
  const lines = text.trim().split('\n').map((line) => line.trim().split(/\s+/));
  if (!lines.every(([, ...numbers]) => numbers.length === 3 && numbers.every((text) => Number.isFinite(Number(text))))) {
    throw new Error(`${name}: expected lines of “name visible x y”`);
  }
  const [seen, hidden] = [true, false].map((wanted) => lines.filter(([, visible]) => Number(visible) > 0 === wanted));
  const points = seen.map(([mark, , x, y]) => ({ name: mark, x: Number(x), y: Number(y) }));
  setLandmarks(shot, points, new Set(hidden.map(([mark]) => mark)));
}

// ---- landmarks

/** Landmarks found or given. @param {Shot} shot @param {import('./editor.js').Point[]} points @param {Set<string>} [skipped] */
function setLandmarks(shot, points, skipped = new Set()) {
  input('show-points').checked = true;
  // Of the first there is nothing to take back.
  if (shot.given) editor.remember();
  shot.given = copied({ points, skipped });
  shot.skipped = skipped;
  editor.set(points);
  editor.face();
}

/** @param {Shot} shot */
function startOver(shot) {
  input('show-points').checked = true;
  if (shot === state.shot) editor.remember();
  shot.skipped = new Set();
  shot.points = [];
  if (shot === state.shot) editor.set([]);
}

async function findLandmarks() {
  if (!state.model) say('Waiting for the face model.');
  await loading;
  if (!isFace(state.model?.landmarks ?? [])) {
    say('Set the landmarks: click where each is in the photo.');
    return;
  }
  state.detecting = true;
  refresh();
  say('Looking for the face.');
  try {
    const { shot } = state;
    if (!shot) return;
    shot.faces = await client.faces(position());
    // A photo dropped meanwhile is looked at by itself.
    if (shot !== state.shot) return;
    if (shot.faces.length === 0) {
      say('No face was found. Set the landmarks by hand: click where each is in the photo.');
      return;
    }
    takeFace(shot, 0);
  } finally {
    state.detecting = false;
  }
}

/** Takes one of the faces found. @param {Shot} shot @param {number} number */
function takeFace(shot, number) {
  const { faces = [] } = shot;
  const known = new Set(wanted(state.model?.landmarks ?? []));
  shot.face = number;
  setLandmarks(shot, faces[number].landmarks.filter(({ name }) => known.has(name)).map((point) => editor.inside(point)));
  const one = 'Found them. Drag what is wrong (eyebrows under glasses, say), then press Fit.';
  say(faces.length > 1 ? `Found ${faces.length} faces; this is face ${number + 1}, by size. Take “Another face”, or press Fit.` : one);
}

on('detect', findLandmarks);
on('next-face', () => {
  const { shot } = state;
  if (shot?.faces) takeFace(shot, ((shot.face ?? 0) + 1) % shot.faces.length);
});
on('clear', () => {
  if (state.shot) startOver(state.shot);
  say('Set the landmarks: click where each is in the photo, or let them be found.');
});
on('skip', () => {
  editor.remember();
  state.shot?.skipped.add(missing()[0]);
});
editor.addEventListener('change', refresh);
editor.addEventListener('place', (event) => place(/** @type {CustomEvent} */ (event).detail));
on('place', () => place({ ...editor.middle, focus: true }));
on('undo', () => editor.undo());
on('reset', () => editor.reset());
document.addEventListener('keydown', (event) => {
  if (event.key.toLowerCase() !== 'z' || event.shiftKey || !(event.ctrlKey || event.metaKey) || button('undo').disabled) return;
  event.preventDefault();
  editor.undo();
});

/** Sets the next landmark, which the keyboard may then move. @param {{ x: number, y: number, focus?: boolean }} where */
function place({ x, y, focus = false }) {
  const [name] = missing();
  if (!name || state.busy !== 'idle' || state.detecting) return;
  editor.remember();
  editor.set([...editor.points, { name, x, y }]);
  if (focus) editor.focus(editor.points.length - 1);
  refresh();
}
input('show-points').addEventListener('change', refresh);
on('zoom-in', () => editor.zoom(1.4));
on('zoom-out', () => editor.zoom(1 / 1.4));
on('zoom-face', () => editor.face());
on('zoom-whole', () => editor.whole());
input('opacity').addEventListener('input', () => editor.fade(input('opacity').valueAsNumber));
input('wipe').addEventListener('input', () => editor.wipe(input('wipe').valueAsNumber));
input('counts').addEventListener('change', () => editor.counts(input('counts').checked));
input('behind').addEventListener('change', () => editor.behind(input('behind').checked));

// ---- the fit

client.addEventListener('progress', (event) => {
  const live = /** @type {CustomEvent<import('../js/worker.js').LiveProgress>} */ (event).detail;
  const { done, total, ended, trace, levels, photo, crop, pictures } = live;
  element('progress', HTMLProgressElement).value = ended ? 1 : done / total;
  element('speed', HTMLElement).textContent = `Step ${done} of at most ${total}`;
  element('live', HTMLElement).hidden = false;
  drawTrace(element('trace', HTMLCanvasElement), trace, levels);
  const shot = state.shots[photo];
  if (!pictures || !shot) return;
  editor.overlay(shot, { pictures, crop });
  showMask();
});

/** The mask of the photo that is shown. */
function showMask() {
  const picture = state.shot?.overlay?.pictures.mask;
  if (!picture) return;
  const mask = element('mask', HTMLCanvasElement);
  [mask.width, mask.height] = [picture.width, picture.height];
  context(mask).drawImage(picture, 0, 0);
}

/** @param {any} job */
async function runFit(job) {
  state.busy = 'fitting';
  swap('fit', 'pause');
  try {
    return await client.fit(job);
  } finally {
    state.busy = 'idle';
    swap(document.activeElement === button('cancel') ? 'cancel' : 'pause', 'fit');
  }
}

/** One button comes in place of another, and takes over the keyboard's focus. @param {string} from @param {string} to */
function swap(from, to) {
  const focused = document.activeElement === button(from);
  refresh();
  if (focused) button(to).focus();
}

on('fit', async () => {
  const { shots, modelName } = state;
  const landmarks = shots.map(({ points }) => points.map((point) => ({ ...point })));
  const photo = shots.map(({ name }) => name);
  // What one photo has once, several have in arrays.
  const job = { landmarks: landmarks[1] ? landmarks : landmarks[0], names: { model: modelName, photo } };
  input('opacity').value = '1';
  editor.fade(1);
  input('wipe').value = '0';
  editor.wipe(0);
  editor.face();
  element('fitted-tools', HTMLElement).hidden = false;
  say('Fitting: from the average face, to a photo less and less blurred.');
  const result = await runFit(job);
  if (!result) {
    say('Cancelled.');
    return;
  }
  state.fitted = { job, result };
  element('verified', HTMLElement).textContent = '';
  showNumbers();
  // They hide what was found.
  input('show-points').checked = false;
  element('numbers', HTMLElement).hidden = false;
  const fitted = await client.fitted();
  // The albedo alone is nobody's skin to the eye: light makes it one.
  element('light', HTMLSelectElement).value = 'photo';
  await client.light('photo', position());
  input('dress').checked = true;
  // Its colours take the worker a while, so the face itself comes first.
  attempt(() => showFace(fitted).then(dress));
  say('Done. Compare with the photo by the sliders; the face is below, to turn, change and save.');
});
on('pause', async () => {
  if (state.busy === 'paused') {
    await client.resume();
    state.busy = 'fitting';
  } else {
    await client.pause();
    state.busy = 'paused';
  }
});
on('cancel', () => client.cancel());
on('verify', async () => {
  const { fitted } = state;
  if (!fitted) return;
  const verdict = element('verified', HTMLElement);
  verdict.textContent = 'Fitting once more…';
  const again = await runFit({ ...fitted.job, live: false });
  if (!again) verdict.textContent = 'Cancelled.';
  else if (again.fingerprint === fitted.result.fingerprint) verdict.textContent = `✓ ${again.fingerprint} again: the same to the last bit.`;
  else verdict.textContent = `✗ ${again.fingerprint}: this must not happen; please report it.`;
});

/** Where the photo that is shown is among all. */
const position = () => (state.shot ? state.shots.indexOf(state.shot) : 0);

/** What was found, of the photo that is shown. */
function showNumbers() {
  const { fingerprint, progress, summary } = state.fitted?.result;
  element('several', HTMLElement).hidden = !Array.isArray(summary);
  const { pixel_rmse: error, landmark_rmse_px: landmarks, steps, mode } = [summary].flat()[position()];
  const percent = (/** @type {number} */ x) => `${(100 * x).toFixed(1)} %`;
  const facts = {
    Fingerprint: fingerprint,
    'Colour error': `${percent(error.initial)} → ${percent(error.best)}`,
    'Landmark error': `${landmarks.toFixed(1)} px of a 256 px cut-out`,
    Steps: `${steps}, ${mode.converged ? 'converged' : 'not converged'}`,
    Time: `${progress.seconds.toFixed(1)} s`,
  };
  const items = Object.entries(facts).flatMap(([name, value]) => {
    const [term, definition] = ['dt', 'dd'].map((tag) => document.createElement(tag));
    term.textContent = name;
    definition.textContent = value;
    return [term, definition];
  });
  element('facts', HTMLElement).replaceChildren(...items);
}

// ---- the face

/** @param {import('../js/worker.js').Coefficients} coefficients */
async function showFace(coefficients) {
  sliders.show(coefficients);
  button('show-fitted').disabled = !state.fitted;
  const light = element('light', HTMLSelectElement);
  const photo = /** @type {HTMLOptionElement} */ (light.querySelector('[value=photo]'));
  photo.disabled = !state.fitted;
  element('dress-tool', HTMLElement).hidden = !state.fitted;
  if (!state.fitted && light.value === 'photo') {
    light.value = 'front';
    await client.light('front');
  }
  await view.draw();
}

/** Lays the photo's colours on the face, or takes them off. */
async function dress() {
  const { checked } = input('dress');
  // A new photo may have come meanwhile.
  if (!state.fitted) return;
  input('dress').disabled = true;
  await client.dress(checked);
  input('dress').disabled = false;
  await view.draw();
}

on('show-fitted', async () => showFace(await client.fitted()));
on('show-random', async () => showFace(await client.random(crypto.getRandomValues(new Uint32Array(1))[0])));
on('show-mean', async () => showFace(await client.mean()));
element('light', HTMLSelectElement).addEventListener('change', () => attempt(illuminate));
input('dress').addEventListener('change', () => attempt(dress));

async function illuminate() {
  await client.light(element('light', HTMLSelectElement).value, position());
  view.draw();
}

/** Saves a file by its ending; where each photo has its own, that of the photo that is shown. @param {string} ending */
async function saveFile(ending) {
  if (state.fitted) await client.dress(input('dress').checked);
  if (ending === 'face.png') return save(ending, await client.png(view.camera));
  const files = ending.startsWith('face.') ? await client.files() : await client.fitFiles();
  if (ending === 'fit.zip') return save(ending, zip(files));
  const found = files.filter(({ name }) => name.endsWith(ending));
  const file = found[position()] ?? found[0];
  if (file) save(file.name.replace('/', '-'), file.bytes);
}

for (const link of document.querySelectorAll('[data-save]')) {
  link.addEventListener('click', () => attempt(() => saveFile(link.getAttribute('data-save') ?? '')));
}

refresh();
// Some browsers start a page from a file, but let it load nothing.
if (location.protocol !== 'file:') {
  element('not-started', HTMLElement).remove();
  say('Drop or choose a photo, or try one of the samples.');
  loading = attempt(loadModel);
}
