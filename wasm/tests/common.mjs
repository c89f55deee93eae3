/** What both tests need: places, the native program, and the browser. */

import { execFileSync } from 'node:child_process';
import { readFileSync, readdirSync, rmSync } from 'node:fs';
import { createServer } from 'node:http';
import { fileURLToPath } from 'node:url';
import { join, relative } from 'node:path';
import { chromium } from 'playwright-core';
import sirv from 'sirv';

const at = (path) => fileURLToPath(new URL(path, import.meta.url));

export const DIST = at('../dist');
/** The package of the page's model. */
export const FACE = at('../face');
export const PHOTOS = at('../../fixtures/photos');
/** Two rough pictures of one face, from the front and from a side. */
export const PAIR = ['05_00.jpg', '05_30.jpg'].map((name) => at(`../../fixtures/rough/${name}`));
/** Where pictures and native results go. */
export const OUT = process.env.OUT ?? at('../dist/test');
const ONESCAN = process.env.ONESCAN ?? at('../../target/release/onescan');

/** Lines that every target computes. */
export const golden = (name) => readFileSync(at(`../../fixtures/golden/${name}.txt`), 'utf8');
/** Runs the native program. @param {string[]} args */
export const run = (...args) => execFileSync(ONESCAN, ['--quiet', ...args], { stdio: 'inherit' });
/** The fingerprint of a search among them. */
export const goldenSearch = (name) => /^search (\w+)$/m.exec(golden(name))[1];

/** The page's model. */
export const model = () => readFileSync(join(FACE, 'face.3dmm'));

/** The file of a photo's landmarks. */
export const marks = (photo) => photo.replace(/\.\w+$/, '.tlms');

/** `fit.json` of the native program's fit of the page's model, a file, to a sample; `found`: to landmarks that it finds. */
export function native(modelFile, photo, options = [], found = false) {
  const out = fitted(modelFile, `native-${photo}`, [join(PHOTOS, photo)], options, found);
  return JSON.parse(readFileSync(join(out, 'fit.json'), 'utf8'));
}

/** Where the native program's fit to photos of one person is: its files, by name. */
export function nativePair(modelFile, options = []) {
  const out = fitted(modelFile, 'native-pair', PAIR, options);
  const names = readdirSync(out, { recursive: true, withFileTypes: true }).filter((entry) => entry.isFile());
  const path = ({ parentPath, name }) => relative(out, join(parentPath, name));
  return new Map(names.map((entry) => [path(entry), readFileSync(join(entry.parentPath, entry.name))]));
}

function fitted(modelFile, name, photos, options, found = false) {
  const out = join(OUT, name);
  rmSync(out, { recursive: true, force: true });
  const landmarks = found ? [] : ['--landmarks', ...photos.map(marks)];
  const fit = ['fit', modelFile, ...photos, ...landmarks, '-o', out];
  // All components: what JavaScript takes by default.
  fit.push('--schedule', 'mode', '--shape-rank', '200', '--albedo-rank', '200');
  run(...fit, ...options);
  return out;
}

/** Serves a directory; `stop()` when done. */
export async function serve(directory) {
  const server = createServer(sirv(directory, { dev: true, etag: true }));
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const stop = () => {
    server.close();
    server.closeAllConnections();
  };
  return { origin: `http://127.0.0.1:${server.address().port}`, stop };
}

/** Serves wasm/dist and opens a browser on it; `close()` when done. */
export async function open() {
  const { origin, stop } = await serve(DIST);
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: [
      '--no-sandbox',
      '--disable-background-networking',
      '--use-fake-device-for-media-stream',
      '--use-fake-ui-for-media-stream',
    ],
  });
  const close = async () => {
    await browser.close();
    stop();
  };
  return { origin, browser, close };
}
