/** What both tests need: places, the native program, and the browser. */

import { execFileSync } from 'node:child_process';
import { readFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { fileURLToPath } from 'node:url';
import { join } from 'node:path';
import { gunzipSync } from 'node:zlib';
import { chromium } from 'playwright-core';
import sirv from 'sirv';

const at = (path) => fileURLToPath(new URL(path, import.meta.url));

export const DIST = at('../dist');
export const PHOTOS = at('../../fixtures/photos');
/** Where pictures and native results go. */
export const OUT = process.env.OUT ?? at('../dist/test');
const ONESCAN = process.env.ONESCAN ?? at('../../target/release/onescan');

/** Lines that every target computes. */
export const golden = (name) => readFileSync(at(`../../fixtures/golden/${name}.txt`), 'utf8');
/** The fingerprint of a search among them. */
export const goldenSearch = (name) => /^search (\w+)$/m.exec(golden(name))[1];

/** The page's model. */
export const model = () => gunzipSync(readFileSync(join(DIST, 'face.3dmm.gz')));

/** `fit.json` of the native program's fit of the page's model, a file, to a sample. */
export function native(modelFile, photo, options = []) {
  const out = join(OUT, `native-${photo}`);
  const landmarks = join(PHOTOS, photo.replace(/\.\w+$/, '.tlms'));
  const fit = ['--quiet', 'fit', modelFile, join(PHOTOS, photo), '--landmarks', landmarks, '-o', out];
  // All components: what JavaScript takes by default.
  fit.push('--schedule', 'mode', '--shape-rank', '200', '--albedo-rank', '200');
  execFileSync(ONESCAN, [...fit, ...options], { stdio: 'inherit' });
  return JSON.parse(readFileSync(join(out, 'fit.json'), 'utf8'));
}

/** Serves wasm/dist and opens a browser on it; `close()` when done. */
export async function open() {
  const server = createServer(sirv(DIST));
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const origin = `http://127.0.0.1:${server.address().port}`;
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: [
      '--no-sandbox',
      '--disable-background-networking',
      '--use-fake-device-for-media-stream',
      '--use-fake-ui-for-media-stream',
      // The face mesh wants WebGL, which machines without a GPU have from this.
      '--use-gl=angle',
      '--use-angle=swiftshader',
      '--enable-unsafe-swiftshader',
    ],
  });
  const close = async () => {
    await browser.close();
    server.close();
  };
  return { origin, browser, close };
}
