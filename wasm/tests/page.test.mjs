/** The page in Chromium, as a visitor uses it. Pictures of it are left in target/browser. */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { cpSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';
import test, { after, before } from 'node:test';
import { DIST, OUT, PAIR, PHOTOS, golden, goldenSearch, model, native, open, serve } from './common.mjs';
import { compare, lines } from '../../tests/wasm/stages.mjs';

/** Prints a file of an archive whose checksums hold. */
const UNZIP = 'import sys, zipfile; z = zipfile.ZipFile(sys.argv[1]); assert z.testzip() is None; sys.stdout.buffer.write(z.read(sys.argv[2]))';
/** What looks for hindrances to people who see, hear or move less. */
const AXE = readFileSync(createRequire(import.meta.url).resolve('axe-core'), 'utf8');
const DESKTOP = { width: 1280, height: 900 };
const PHONE = { width: 390, height: 844 };

let site;
before(async () => {
  site = await open();
});
after(() => site?.close());

/** A fresh page, and whatever it does that it should not. */
async function visit(viewport, setUp = async () => {}) {
  const context = await site.browser.newContext({ viewport, acceptDownloads: true, serviceWorkers: 'block' });
  const page = await context.newPage();
  const faults = [];
  page.on('pageerror', (error) => faults.push(`error: ${error.message}`));
  page.on('console', (message) => {
    if (message.type() === 'error' && !/favicon/.test(message.text())) faults.push(message.text());
  });
  page.on('request', (request) => {
    const url = request.url();
    if (!/^(blob:|data:)/.test(url) && !url.startsWith(site.origin)) faults.push(`request: ${url}`);
  });
  await setUp(page);
  await page.goto(site.origin);
  return { page, faults, close: () => context.close() };
}

const message = (page) => page.locator('#message').innerText();
const said = (page, text, timeout = 20_000) =>
  page
    .waitForFunction((t) => document.getElementById('message').textContent.includes(t), text, { timeout })
    .catch(async () => assert.fail(`“${text}” was not said, but: ${await message(page)}`));
const ready = (page) => page.locator('#result').waitFor({ state: 'visible' });
const shot = (page, name) => page.screenshot({ path: join(OUT, `${name}.png`), fullPage: true });

/**
 * Milliseconds the page's main thread computed in its longest task. Of its own time, so that a busy
 * machine does not count.
 */
function longestTask(events) {
  const mains = events.filter(({ name, args }) => name === 'thread_name' && args.name === 'CrRendererMain');
  const threads = new Set(mains.map(({ pid, tid }) => `${pid} ${tid}`));
  const tasks = events.filter(({ tdur, pid, tid }) => tdur > 0 && threads.has(`${pid} ${tid}`));
  assert.ok(tasks.length > 100, `${tasks.length} tasks were traced`);
  return Math.max(...tasks.map(({ tdur }) => tdur)) / 1000;
}

const parse = (text) =>
  text.trim().split('\n').map((line) => line.split(/\s+/))
    .filter(([, visible]) => visible !== '0')
    .map(([name, , x, y]) => ({ name, x: Number(x), y: Number(y) }));
/** A photo's landmarks, set by hand. */
const landmarks = (photo) => parse(readFileSync(join(PHOTOS, `${photo}.tlms`), 'utf8'));

async function download(page, selector) {
  const [file] = await Promise.all([page.waitForEvent('download'), page.click(selector)]);
  return { name: file.suggestedFilename(), bytes: readFileSync(await file.path()) };
}

/** Nothing on the page hinders anybody, as far as axe sees, in the light and in the dark. */
async function accessible(page) {
  await page.evaluate(AXE);
  for (const colorScheme of ['dark', 'light']) {
    await page.emulateMedia({ colorScheme });
    const found = await page.evaluate(async () => {
      const tags = ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'];
      const { violations } = await globalThis.axe.run(document, { runOnly: tags });
      return violations.flatMap(({ id, nodes }) => nodes.map(({ target, failureSummary }) => `${id}: ${target} ${failureSummary}`));
    });
    assert.deepEqual(found, [], colorScheme);
  }
}

/** The face is drawn as it is to be. */
const rested = (page) => page.waitForSelector('#dress:enabled, #dress-tool[hidden]', { state: 'attached' }).then(() => page.waitForSelector('#view[aria-busy="false"]'));

/** The colours of a canvas, shrunk to a few. */
const look = (page, id) =>
  page.evaluate((canvasId) => {
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = 32;
    const draw = canvas.getContext('2d');
    draw.drawImage(document.getElementById(canvasId), 0, 0, 32, 32);
    return [...draw.getImageData(0, 0, 32, 32).data];
  }, id);

const difference = (a, b) => a.reduce((sum, value, i) => sum + Math.abs(value - b[i]), 0) / a.length;

test('a sample is fitted to the native fingerprint, turned, changed, saved', { timeout: 300_000 }, async () => {
  const { page, faults, close } = await visit(DESKTOP);
  await ready(page);
  await shot(page, 'start');
  await page.click('[data-sample="astronaut.png"]');
  await said(page, 'Press Fit');
  assert.equal(await page.locator('#handles g').count(), landmarks('astronaut').length);
  await shot(page, 'landmarks');

  await site.browser.startTracing(page, { categories: ['toplevel'] });
  const start = performance.now();
  await page.click('#fit');
  await page.waitForFunction(() => /^Step [1-9]/.test(document.getElementById('speed').textContent));
  await page.click('#pause');
  await page.locator('#pause', { hasText: 'Resume' }).waitFor();
  const paused = await page.locator('#speed').innerText();
  await page.waitForTimeout(300);
  assert.equal(await page.locator('#speed').innerText(), paused);
  await page.click('#pause');
  await said(page, 'Done', 120_000);
  assert.equal(await page.locator('#light').inputValue(), 'photo');
  const seconds = (performance.now() - start) / 1000;
  const longest = longestTask(JSON.parse(await site.browser.stopTracing()).traceEvents);

  const summary = JSON.parse((await download(page, '[data-save="fit.json"]')).bytes);
  const modelFile = join(OUT, 'page.3dmm');
  writeFileSync(modelFile, model());
  const expected = native(modelFile, 'astronaut.png');
  assert.equal(summary.fingerprint, expected.fingerprint);
  assert.deepEqual(summary.parameters, expected.parameters);
  assert.ok((await page.locator('#facts').innerText()).includes(expected.fingerprint));
  const ratio = summary.steps_per_second / expected.steps_per_second;
  console.log(
    `browser ${summary.steps_per_second.toFixed(1)} steps/s, native ${expected.steps_per_second.toFixed(1)}: ` +
      `${ratio.toFixed(2)}; ${seconds.toFixed(1)} s in all; longest task of the page ${longest.toFixed(1)} ms`,
  );
  // Her hair is before the face, so the switch changes something, and the mask is neither white nor black.
  const before = await look(page, 'photo');
  await page.uncheck('#behind');
  await page.waitForTimeout(300);
  assert.ok(difference(before, await look(page, 'photo')) > 0.05, 'the switch shows what is behind');
  await shot(page, 'done-whole');
  await page.check('#behind');
  const mask = await look(page, 'mask');
  assert.ok(mask.some((x, i) => i % 4 < 3 && x < 30) && mask.some((x, i) => i % 4 < 3 && x > 225));
  await shot(page, 'done');

  await rested(page);
  const frontal = await look(page, 'view');
  await page.locator('#view').focus();
  for (let i = 0; i < 4; i += 1) await page.keyboard.press('ArrowRight');
  await rested(page);
  const turned = await look(page, 'view');
  assert.ok(difference(frontal, turned) > 2, 'arrow keys turn the face');
  const box = await page.locator('#view').boundingBox();
  await page.mouse.move(box.x + 200, box.y + 200);
  await page.mouse.down();
  await page.mouse.move(box.x + 100, box.y + 220, { steps: 5 });
  await page.mouse.up();
  await rested(page);
  assert.ok(difference(turned, await look(page, 'view')) > 2, 'dragging turns the face');
  await page.selectOption('#light', 'left');
  await page.click('#show-random');
  await page.waitForTimeout(100);
  await rested(page);
  await shot(page, 'random');
  const slider = page.locator('#sliders input').first();
  const random = await look(page, 'view');
  await slider.fill('3');
  await page.waitForTimeout(100);
  await rested(page);
  assert.ok(difference(random, await look(page, 'view')) > 0.2, 'a slider changes the face');
  // All components have one, the most in folds.
  const folds = page.locator('#sliders summary');
  for (const fold of await folds.all()) await fold.click();
  const { shape, albedo } = summary.parameters;
  await page.waitForFunction((count) => document.querySelectorAll('#sliders input').length === count, shape.length + albedo.length);
  const early = await look(page, 'view');
  await page.locator('#sliders label', { hasText: '25' }).first().locator('input').fill('-3');
  await page.waitForTimeout(100);
  await rested(page);
  assert.ok(difference(early, await look(page, 'view')) > 0.05, 'so does one of a fold');
  await shot(page, 'folds');
  for (const fold of await folds.all()) await fold.click();
  await page.click('#show-fitted');

  // Of the fitted face with the photo's colours; of another colour with its own.
  const glb = async () => {
    const { bytes } = await download(page, '[data-save="face.glb"]');
    assert.equal(bytes.subarray(0, 4).toString(), 'glTF');
    return JSON.parse(bytes.subarray(20, 20 + bytes.readUInt32LE(12)).toString());
  };
  assert.equal((await glb()).images.length, 1);
  await rested(page);
  const dressed = await look(page, 'view');
  await shot(page, 'textured');
  await page.uncheck('#dress');
  await page.waitForTimeout(100);
  await rested(page);
  assert.ok(difference(dressed, await look(page, 'view')) > 0.5, 'the photo’s colours are seen');
  assert.equal((await glb()).images, undefined);
  await page.check('#dress');
  await page.click('#show-random');
  assert.equal((await glb()).images, undefined);
  await page.click('#show-fitted');
  const ply = await download(page, '[data-save="face.ply"]');
  assert.equal(ply.bytes.subarray(0, 3).toString(), 'ply');
  const png = await download(page, '[data-save="face.png"]');
  assert.equal(png.bytes.subarray(1, 4).toString(), 'PNG');
  assert.match((await download(page, '[data-save="report.html"]')).bytes.toString(), /^<!doctype html>/i);
  assert.match((await download(page, '[data-save=".tlms"]')).bytes.toString(), /center.nose.tip 1 /);

  await page.click('#verify');
  await page.locator('#verified', { hasText: 'the same to the last bit' }).waitFor({ timeout: 120_000 });
  assert.deepEqual(faults, []);
  await close();
  assert.ok(longest < 50, `a task of ${longest} ms holds up the page`);
});

test('Chromium computes the golden stages and fits', { timeout: 300_000 }, async () => {
  const stages = new URL('../../tests/wasm/stages.mjs', import.meta.url);
  const { page, close } = await visit(DESKTOP, (it) =>
    it.route('**/stages.mjs', (route) => route.fulfill({ path: fileURLToPath(stages), contentType: 'text/javascript' })),
  );
  await ready(page);
  for (const kind of ['SCALAR', 'SIMD128']) {
    const bytes = readFileSync(process.env[`STAGES_${kind}`]).toString('base64');
    const found = await page.evaluate(
      async ([run, encoded, expected]) => {
        const { lines: compute } = await import(run);
        return compute(Uint8Array.from(atob(encoded), (c) => c.charCodeAt(0)), expected);
      },
      ['/stages.mjs', bytes, golden('device')],
    );
    compare(found, golden('device'));
  }
  // The page's own program, a model of full size, everything by default.
  await page.locator('#steps summary').click();
  await page.setInputFiles('#model', join(process.env.FULL, 'face.3dmm'));
  await said(page, 'face.3dmm is the model now');
  await page.click('[data-sample="astronaut.png"]');
  await said(page, 'Press Fit');
  await page.click('#fit');
  await said(page, 'Done', 120_000);
  const { fingerprint } = JSON.parse((await download(page, '[data-save="fit.json"]')).bytes);
  assert.equal(fingerprint, goldenSearch('full'));
  await close();
});

test('a photo is pasted, and landmarks are dropped on it', { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit(DESKTOP);
  await ready(page);
  const give = (type, name, bytes) =>
    page.evaluate(
      ([event, file, encoded]) => {
        const data = new DataTransfer();
        data.items.add(new File([Uint8Array.from(atob(encoded), (c) => c.charCodeAt(0))], file));
        const init = { bubbles: true, cancelable: true };
        document.body.dispatchEvent(
          event === 'paste'
            ? new ClipboardEvent(event, { ...init, clipboardData: data })
            : new DragEvent(event, { ...init, dataTransfer: data }),
        );
      },
      [type, name, bytes.toString('base64')],
    );
  await give('drop', 'early.tlms', Buffer.from('a 1 2 3'));
  await said(page, 'early.tlms: open the photo first');
  await give('paste', 'pasted.png', readFileSync(join(PHOTOS, 'astronaut.png')));
  await said(page, 'Found them');
  await give('drop', 'own.tlms', readFileSync(join(PHOTOS, 'astronaut.tlms')));
  await page.waitForFunction((count) => document.querySelectorAll('#handles g').length === count, landmarks('astronaut').length);
  await give('drop', 'bad.tlms', Buffer.from('center.nose.tip 1 2'));
  await said(page, 'bad.tlms: expected lines');
  assert.deepEqual(faults, []);
  await close();
});

test('the page is seen before the model is there', async () => {
  let release;
  const held = new Promise((resolve) => (release = resolve));
  const { page, close } = await visit(PHONE, (it) =>
    it.route('**/face.3dmm.gz', async (route) => {
      await held;
      await route.continue();
    }),
  );
  await page.locator('#drop').waitFor({ state: 'visible' });
  const paint = () => page.evaluate(() => performance.getEntriesByName('first-contentful-paint').length);
  await page.waitForFunction(() => performance.getEntriesByName('first-contentful-paint').length > 0);
  assert.equal(await paint(), 1);
  assert.equal(await page.locator('#result').isVisible(), false);
  // A photo that is there first waits for it, and keeps its landmarks.
  await page.setInputFiles('#file', join(PHOTOS, 'astronaut.png'));
  await said(page, 'Waiting for the face model');
  release();
  await ready(page);
  await said(page, 'Found them');
  assert.equal(await page.locator('#handles g').count(), 16);
  await close();
});

test('a phone: landmarks are found, moved by keys, and the fit runs', { timeout: 300_000 }, async () => {
  const { page, faults, close } = await visit(PHONE);
  await ready(page);
  await page.setInputFiles('#file', join(PHOTOS, 'obama.jpg'));
  await said(page, 'Found them');
  assert.equal(await page.locator('#handles g').count(), 16);
  assert.equal(await page.locator('#next-face').isVisible(), false, 'there is but one');
  await shot(page, 'phone-landmarks');
  const handle = page.locator('#handles g').nth(9);
  const place = () => handle.getAttribute('transform');
  const start = await place();
  await handle.focus();
  await page.keyboard.press('Shift+ArrowLeft');
  assert.notEqual(await place(), start);
  await page.keyboard.press('Shift+ArrowRight');
  await page.click('#fit');
  await said(page, 'Done', 120_000);
  // What was found is near what was set by hand: within a tenth of the distance of the eyes.
  const found = parse((await download(page, '[data-save=".tlms"]')).bytes.toString());
  const byHand = landmarks('obama');
  const distance = (a, b) => Math.hypot(a.x - b.x, a.y - b.y);
  const named = (all, name) => all.find((landmark) => landmark.name === name);
  const eyes = ['right', 'left'].map((side) => named(byHand, `${side}.eye.corner_outer`));
  for (const landmark of found) {
    const share = distance(landmark, named(byHand, landmark.name)) / distance(...eyes);
    assert.ok(share < 0.1, `${landmark.name}: ${share}`);
  }
  await shot(page, 'phone');
  const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert.equal(overflow, 0, 'nothing is wider than the screen');
  assert.deepEqual(faults, []);
  await close();
});

for (const [device, viewport] of Object.entries({ desktop: DESKTOP, phone: PHONE })) {
  test(`two photos of one person are fitted together: ${device}`, { timeout: 300_000 }, async () => {
    const { page, faults, close } = await visit(viewport);
    await ready(page);
    assert.equal(await page.locator('#add').isVisible(), false);
    await page.setInputFiles('#file', PAIR[0]);
    await said(page, 'Found them');
    await page.locator('#add').waitFor({ state: 'visible' });
    const [chooser] = await Promise.all([page.waitForEvent('filechooser'), page.click('#add')]);
    await chooser.setFiles(PAIR[1]);
    const tabs = page.locator('#shots button');
    await tabs.nth(1).waitFor({ state: 'visible' });
    await page.waitForFunction(() => !document.getElementById('fit').disabled);
    await shot(page, `pair-landmarks-${device}`);
    const place = () => page.locator('#handles g').first().getAttribute('transform');
    const pressed = () => tabs.evaluateAll((all) => all.map((tab) => tab.ariaPressed));
    assert.deepEqual(await pressed(), ['false', 'true']);

    // Each has its own landmarks, and the keyboard switches between them.
    const second = await place();
    await tabs.nth(0).focus();
    await page.keyboard.press('Enter');
    assert.deepEqual(await pressed(), ['true', 'false']);
    const first = await place();
    assert.notEqual(first, second);
    await page.locator('#handles g').first().focus();
    await page.keyboard.press('ArrowLeft');
    await page.keyboard.press('ArrowRight');
    await tabs.nth(1).click();
    assert.equal(await place(), second);

    // A photo without landmarks holds up the fit.
    await page.click('#clear');
    assert.equal(await page.locator('#fit').isDisabled(), true);
    assert.match(await tabs.nth(1).getAttribute('title'), /landmarks are missing/);
    await tabs.nth(0).click();
    assert.equal(await page.locator('#fit').isDisabled(), true);
    await tabs.nth(1).click();
    await page.click('#detect');
    await said(page, 'Found them');

    await page.click('#fit');
    await page.waitForFunction(() => /^Step [1-9]/.test(document.getElementById('speed').textContent));
    // The other one can be watched meanwhile.
    await tabs.nth(0).click();
    await said(page, 'Done', 200_000);
    await shot(page, `pair-${device}`);
    await accessible(page);
    const front = { photo: await look(page, 'photo'), mask: await look(page, 'mask') };
    const facts = await page.locator('#facts').innerText();
    await rested(page);
    const lit = await look(page, 'view');
    await tabs.nth(1).click();
    await page.waitForTimeout(300);
    await rested(page);
    assert.ok(difference(lit, await look(page, 'view')) > 1, 'the face is lit as in the photo that is shown');
    assert.ok(difference(front.photo, await look(page, 'photo')) > 2, 'the other photo is shown');
    assert.ok(difference(front.mask, await look(page, 'mask')) > 1, 'with its mask');
    assert.notEqual(await page.locator('#facts').innerText(), facts);
    const fitted = await look(page, 'photo');
    await page.locator('#opacity').fill('0');
    await page.waitForTimeout(300);
    assert.ok(difference(fitted, await look(page, 'photo')) > 0.2, 'and the model over it');
    await page.locator('#opacity').fill('1');
    await shot(page, `pair-side-${device}`);

    const { name, bytes } = await download(page, '[data-save="fit.json"]');
    assert.equal(name, '05_30-fit.json');
    const side = JSON.parse(bytes);
    const all = await download(page, '[data-save="fit.zip"]');
    const archive = join(OUT, `pair-${device}.zip`);
    writeFileSync(archive, all.bytes);
    const unpacked = (file) => execFileSync('python3', ['-c', UNZIP, archive, file], { maxBuffer: 1e8 });
    const { fits } = JSON.parse(unpacked('summary.json'));
    assert.deepEqual(fits.map(({ image }) => image.file), ['05_00.jpg', '05_30.jpg']);
    assert.deepEqual(fits[1], side);
    assert.deepEqual(fits[0].parameters.shape, side.parameters.shape);
    // From the front and from a side.
    const yaws = fits.map(({ parameters }) => parameters.pose.yaw);
    assert.ok(Math.abs(yaws[0] - yaws[1]) > 0.3, `yaws ${yaws}`);
    for (const file of ['05_00/overlay.png', '05_30/overlay.png', '05_30/fit.rps', 'report.html', 'mesh.glb', '05_30.tlms']) {
      assert.ok(unpacked(file).length > 100, file);
    }

    if (device === 'desktop') {
      await page.click('#verify');
      await page.locator('#verified', { hasText: 'the same to the last bit' }).waitFor({ timeout: 200_000 });
    }
    await page.click('#remove');
    await said(page, '05_30.jpg is removed');
    assert.equal(await tabs.count(), 0);
    assert.equal(await place(), first);
    assert.equal(await page.locator('#numbers').isVisible(), false);
    // Nor is its face there any more.
    assert.equal(await page.locator('#dress').isVisible(), false);
    assert.equal(await page.locator('#light').inputValue(), 'front');
    assert.equal(await page.locator('#fit').isDisabled(), false);
    const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.equal(overflow, 0, 'nothing is wider than the screen');
    assert.deepEqual(faults, []);
    await close();
  });
}

test('landmarks by hand, keyboard alone', { timeout: 120_000 }, async () => {
  const { page, close } = await visit(DESKTOP);
  await ready(page);
  await page.click('[data-sample="grace_hopper.jpg"]');
  await said(page, 'Press Fit');
  await page.click('#clear');
  assert.equal(await page.locator('#handles g').count(), 0);
  assert.equal(await page.locator('#fit').isDisabled(), true);
  const box = await page.locator('#stage').boundingBox();
  for (const [x, y] of [[0.45, 0.4], [0.49, 0.4], [0.52, 0.4]]) {
    await page.mouse.click(box.x + x * box.width, box.y + y * box.height);
  }
  await page.click('#skip');
  await page.mouse.click(box.x + 0.45 * box.width, box.y + 0.45 * box.height);
  assert.equal(await page.locator('#handles g').count(), 4);
  const labels = await page.locator('#handles g').evaluateAll((all) => all.map((g) => g.getAttribute('aria-label')));
  assert.match(labels[3], /^right eye corner outer/);
  assert.equal(await page.locator('#fit').isDisabled(), false);
  await shot(page, 'by-hand');
  await page.locator('#handles g').nth(0).focus();
  await page.keyboard.press('Delete');
  assert.equal(await page.locator('#handles g').count(), 3);
  assert.equal(await page.locator('#fit').isDisabled(), true);
  await close();
});

test('landmarks are set by the keyboard, taken back and brought back', { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit(DESKTOP);
  await ready(page);
  await page.click('[data-sample="grace_hopper.jpg"]');
  await said(page, 'Press Fit');
  const handles = page.locator('#handles g');
  const places = () => handles.evaluateAll((all) => all.map((g) => `${g.textContent} ${g.getAttribute('transform')}`));
  const given = await places();
  assert.equal(await page.locator('#undo').isDisabled(), true);
  // All steps of keys at one landmark are one change.
  await handles.nth(2).focus();
  for (const key of ['ArrowLeft', 'ArrowUp', 'Shift+ArrowUp']) await page.keyboard.press(key);
  const moved = await places();
  assert.notDeepEqual(moved, given);
  await page.keyboard.press('Delete');
  assert.equal(await handles.count(), given.length - 1);
  // The keyboard goes on from where it was.
  assert.equal(await page.evaluate(() => document.activeElement.closest('#handles') !== null), true);
  await page.keyboard.press('Control+z');
  assert.deepEqual(await places(), moved);
  await page.keyboard.press('Control+z');
  assert.deepEqual(await places(), given);
  assert.equal(await page.locator('#undo').isDisabled(), true);

  await page.click('#clear');
  await page.locator('#place').focus();
  await page.keyboard.press('Enter');
  await page.keyboard.press('Shift+ArrowDown');
  await page.keyboard.press('Enter');
  await page.keyboard.press('Shift+ArrowRight');
  await page.keyboard.press('Enter');
  await page.keyboard.press('Shift+ArrowUp');
  await page.keyboard.press('Enter');
  const set = await places();
  assert.equal(set.length, 4);
  assert.equal(new Set(set.slice(0, 3).map((text) => text.replace(/.*translate/, ''))).size, 3);
  assert.equal(await page.locator('#fit').isDisabled(), false);
  await page.click('#reset');
  assert.deepEqual(await places(), given);
  await page.click('#undo');
  assert.deepEqual(await places(), set);
  // By the mouse: a drag is one change, and so is what cannot be seen.
  const box = await handles.nth(0).locator('.dot').boundingBox();
  await page.mouse.move(box.x + 5, box.y + 5);
  await page.mouse.down();
  await page.mouse.move(box.x + 80, box.y + 60, { steps: 4 });
  await page.mouse.up();
  assert.notDeepEqual(await places(), set);
  const next = await page.locator('#next').innerText();
  await page.click('#skip');
  assert.notEqual(await page.locator('#next').innerText(), next);
  await page.click('#undo');
  assert.equal(await page.locator('#next').innerText(), next);
  await page.click('#undo');
  assert.deepEqual(await places(), set);
  assert.deepEqual(faults, []);
  await close();
});

for (const [device, viewport] of Object.entries({ desktop: DESKTOP, phone: PHONE })) {
  test(`photo, status and Fit stay in sight, and nothing is too small to hit: ${device}`, { timeout: 120_000 }, async () => {
    const { page, faults, close } = await visit(viewport);
    await ready(page);
    const inSight = async () => {
      for (const step of await page.locator('#steps > section').all()) {
        await step.evaluate((it) => it.scrollIntoView({ block: 'center' }));
        const seen = await page.evaluate(() => {
          const [stage, bar, fit] = ['stage', 'bar', 'fit'].map((id) => document.getElementById(id).getBoundingClientRect());
          const { bottom } = document.getElementById('cancel').hidden ? fit : document.getElementById('cancel').getBoundingClientRect();
          return { photo: Math.min(stage.bottom, bar.top) - Math.max(stage.top, 0), bar: bar.bottom <= innerHeight && bar.top > 0, fit: bottom > 0 && bottom <= innerHeight };
        });
        assert.ok(seen.photo > 250 && seen.bar && seen.fit, JSON.stringify(seen));
      }
      const small = await page.evaluate(() =>
        [...document.querySelectorAll('button, input, select, summary, label.button, #handles g')]
          .filter((it) => it.checkVisibility({ visibilityProperty: true }) && !it.classList.contains('visually-hidden'))
          .map((it) => [it.id || it.textContent, it.getBoundingClientRect()])
          .filter(([, { width, height }]) => width < 24 || height < 24)
          .map(([name, { width, height }]) => `${name}: ${width} × ${height}`),
      );
      assert.deepEqual(small, []);
    };
    await inSight();
    await accessible(page);
    await page.setInputFiles('#file', join(PHOTOS, 'obama.jpg'));
    await said(page, 'Found them');
    await inSight();
    await accessible(page);
    await page.click('#clear');
    await inSight();
    await accessible(page);
    await page.click('#undo');
    await page.click('#fit');
    await page.waitForFunction(() => document.getElementById('progress').value > 0.2);
    await page.click('#pause');
    await inSight();
    await accessible(page);
    await shot(page, `fitting-${device}`);
    await page.click('#pause');
    await said(page, 'Done', 120_000);
    await inSight();
    for (const fold of await page.locator('summary').all()) await fold.click();
    await accessible(page);
    for (const fold of await page.locator('summary').all()) await fold.click();

    // Before and after, and what counts.
    await page.waitForTimeout(500);
    const fitted = await look(page, 'photo');
    await page.locator('#wipe').fill('0.5');
    await page.waitForTimeout(300);
    const half = await look(page, 'photo');
    const part = (a, b, left) => difference(...[a, b].map((all) => all.filter((_, i) => (i >> 2) % 32 < 15 === left)));
    assert.ok(part(fitted, half, true) > 0.2, 'on the left the photo');
    assert.ok(part(fitted, half, false) < 0.5, 'on the right the fit');
    await page.locator('#wipe').fill('0');
    await page.check('#counts');
    await page.waitForTimeout(300);
    assert.ok(difference(fitted, await look(page, 'photo')) > 5, 'what does not count is dark');
    await shot(page, `counts-${device}`);
    await page.uncheck('#counts');

    // The wheel zooms about the mouse, two fingers about their middle.
    const place = () => page.locator('#handles g').first().getAttribute('transform');
    const [x, y] = await page.locator('#stage').evaluate((stage) => {
      stage.scrollIntoView({ block: 'center' });
      const box = stage.getBoundingClientRect();
      return [box.left + box.width / 2, box.top + box.height / 2];
    });
    let before = await place();
    await page.mouse.move(x, y);
    await page.mouse.wheel(0, -300);
    await page.waitForFunction((old) => document.querySelector('#handles g').getAttribute('transform') !== old, before);
    before = await place();
    const touch = await page.context().newCDPSession(page);
    const fingers = (type, ...apart) =>
      touch.send('Input.dispatchTouchEvent', { type, touchPoints: apart.flatMap((d) => [{ x: x - d, y, id: 0 }, { x: x + d, y, id: 1 }]) });
    await fingers('touchStart', 30);
    await fingers('touchMove', 60);
    await fingers('touchMove', 90);
    await fingers('touchEnd');
    const parsed = (text) => text.match(/-?[\d.]+/g).map(Number);
    const box = await page.locator('#stage').boundingBox();
    const from = parsed(before).map((value, axis) => value - [box.width, box.height][axis] / 2);
    const to = parsed(await place()).map((value, axis) => value - [box.width, box.height][axis] / 2);
    for (const axis of [0, 1]) assert.ok(Math.abs(to[axis] - 3 * from[axis]) < 2, `${from} → ${to}`);
    assert.deepEqual(faults, []);
    await close();
  });
}

test('a running fit is cancelled, and the page goes on', { timeout: 120_000 }, async () => {
  const { page, close } = await visit(DESKTOP);
  await ready(page);
  await page.click('[data-sample="astronaut.png"]');
  await said(page, 'Press Fit');
  await page.click('#fit');
  await page.waitForFunction(() => document.getElementById('progress').value > 0.2);
  await page.click('#pause');
  await shot(page, 'fitting');
  await page.click('#cancel');
  await said(page, 'Cancelled');
  assert.equal(await page.locator('#fit').isDisabled(), false);
  await close();
});

test('what is damaged is refused with a message, and nothing is lost', async () => {
  const { page, close } = await visit(DESKTOP);
  await ready(page);
  const file = (name, buffer) => ({ name, mimeType: 'application/octet-stream', buffer: Buffer.from(buffer) });
  await page.setInputFiles('#file', file('broken.jpg', readFileSync(join(PHOTOS, 'obama.jpg')).subarray(0, 200_000)));
  await said(page, 'broken.jpg: the JPEG is cut off');
  await page.setInputFiles('#file', file('notes.txt', 'not a picture'));
  await said(page, 'notes.txt: not a picture this browser reads');
  const bytes = Buffer.from(model());
  bytes[100_000] ^= 1;
  await page.locator('#steps summary').click();
  await page.setInputFiles('#model', file('own.3dmm', bytes));
  await said(page, 'own.3dmm: ');
  assert.match(await message(page), /damaged|checksum/);
  await page.click('[data-sample="astronaut.png"]');
  await said(page, 'Press Fit');
  await page.setInputFiles('#model', file('own.3dmm', model()));
  await said(page, 'own.3dmm is the model now');
  const left = await page.locator('#handles g').count();
  assert.equal(left, landmarks('astronaut').length, 'the landmarks stay');
  await close();
});

test('the camera', async () => {
  const { page, faults, close } = await visit(PHONE);
  await ready(page);
  await page.click('#camera');
  await page.locator('#video').waitFor({ state: 'visible' });
  await accessible(page);
  await shot(page, 'camera');
  await page.click('#shoot');
  // Chromium's test picture has no face.
  await said(page, 'No face was found');
  assert.deepEqual(faults, []);
  await close();
});

test('a camera refused, absent and in use are told apart', async () => {
  const { page, close } = await visit(DESKTOP);
  await ready(page);
  for (const [name, text] of [['NotAllowedError', 'was refused; allow it'], ['NotFoundError', 'has no camera'], ['NotReadableError', 'another program']]) {
    await page.evaluate((kind) => {
      navigator.mediaDevices.getUserMedia = async () => { throw new DOMException('no', kind); };
    }, name);
    await page.click('#camera');
    await said(page, text);
  }
  await close();
});

test('opened from a file, the page says why it cannot run', async () => {
  const page = await site.browser.newPage({ viewport: PHONE });
  await page.goto(`file://${join(DIST, 'index.html')}`);
  await page.locator('#not-started').waitFor({ state: 'visible' });
  assert.match(await page.locator('#not-started').innerText(), /opened from a file/);
  await shot(page, 'file');
  await page.close();
  const served = await visit(PHONE);
  await ready(served.page);
  assert.equal(await served.page.locator('#not-started').count(), 0);
  await served.close();
});

test('one of two faces is chosen', { timeout: 120_000 }, async () => {
  const { page, faults, close } = await visit(DESKTOP);
  await ready(page);
  const [both, widths] = await page.evaluate(async () => {
    const load = async (name) => createImageBitmap(await (await fetch(`samples/${name}`)).blob());
    const photos = await Promise.all(['obama.jpg', 'grace_hopper.jpg'].map(load));
    const canvas = document.createElement('canvas');
    canvas.width = photos[0].width + photos[1].width;
    canvas.height = Math.max(photos[0].height, photos[1].height);
    const draw = canvas.getContext('2d');
    draw.drawImage(photos[0], 0, 0);
    draw.drawImage(photos[1], photos[0].width, 0);
    return [canvas.toDataURL().split(',')[1], photos.map(({ width }) => width)];
  });
  await page.setInputFiles('#file', { name: 'both.png', mimeType: 'image/png', buffer: Buffer.from(both, 'base64') });
  await said(page, 'Found 2 faces; this is face 1');
  await shot(page, 'two-faces');
  await page.click('#next-face');
  await said(page, 'this is face 2');
  await page.click('#next-face');
  await said(page, 'this is face 1');
  await page.click('#next-face');
  await page.click('#fit');
  await said(page, 'Done', 120_000);
  // She is on the right.
  const found = parse((await download(page, '[data-save=".tlms"]')).bytes.toString());
  const byHand = new Map(landmarks('grace_hopper').map(({ name, x, y }) => [name, [x + widths[0], y]]));
  for (const { name, x, y } of found) {
    const [tx, ty] = byHand.get(name) ?? [x, y];
    assert.ok(Math.hypot(x - tx, y - ty) < 20, `${name}: ${[x, y]}, by hand ${[tx, ty]}`);
  }
  assert.deepEqual(faults, []);
  await close();
});

test('the page works without a network, and is never an old one with it', { timeout: 120_000 }, async () => {
  const place = join(OUT, 'site');
  rmSync(place, { recursive: true, force: true });
  cpSync(DIST, place, { recursive: true, filter: (path) => !/dist.(test|.*\.d\.ts$)/.test(path) });
  const server = await serve(place);
  after(server.stop);
  const context = await site.browser.newContext({ viewport: DESKTOP });
  const page = await context.newPage();
  await page.goto(server.origin);
  await ready(page);
  const kept = () => page.evaluate(async () => (await caches.keys()).join());
  const keeps = async (version) => {
    for (let i = 0; (await kept()) !== `onescan ${version}`; i += 1) {
      assert.ok(i < 100, `${version} is not kept, but: ${await kept()}`);
      await page.waitForTimeout(100);
    }
    await page.evaluate(() => navigator.serviceWorker.ready);
  };
  const [, first] = /VERSION = '(\w+)'/.exec(readFileSync(join(place, 'sw.js'), 'utf8'));
  await keeps(first);

  // A new build is there at once, and takes the place of what was kept.
  const change = (name, from, to) => writeFileSync(join(place, name), readFileSync(join(place, name), 'utf8').replace(from, to));
  change('index.html', '<h1>onescan', '<h1>onescan, the second');
  change('page/app.js', 'Drop or choose a photo', 'Drop or take a photo');
  change('sw.js', first, 'second');
  await page.reload();
  assert.equal(await page.locator('h1').innerText(), 'onescan, the second');
  await said(page, 'Drop or take a photo');
  await keeps('second');

  server.stop();
  await page.reload();
  await ready(page);
  assert.equal(await page.locator('h1').innerText(), 'onescan, the second');
  await page.setInputFiles('#file', join(PHOTOS, 'obama.jpg'));
  await said(page, 'Found them');
  await page.click('#fit');
  await said(page, 'Done', 120_000);
  await context.close();
});

test('nothing leaves the page', async () => {
  const { page, close } = await visit(DESKTOP);
  await ready(page);
  const policy = await page.getAttribute('meta[http-equiv="Content-Security-Policy"]', 'content');
  assert.match(policy, /connect-src 'self';/);
  assert.doesNotMatch(policy, /'unsafe-(eval|inline)'/);
  // The worker alone is born of lines of script, and no address is a script's by chance.
  assert.deepEqual(policy.split('; ').filter((rule) => rule.includes('blob:')), ["worker-src 'self' blob:"]);
  assert.equal(await page.evaluate(() => { try { new Worker('js/worker.js'); } catch (error) { return error.name; } }), 'TypeError');
  const elsewhere = 'http://localhost:9/';
  const tried = await page.evaluate(async (url) => {
    const refused = [];
    document.addEventListener('securitypolicyviolation', (event) => refused.push(event.effectiveDirective));
    await fetch(url, { method: 'POST', body: 'photo', mode: 'no-cors' }).catch(() => {});
    navigator.sendBeacon(url, 'photo');
    new Image().src = `${url}?photo`;
    await new Promise((resolve) => setTimeout(resolve, 200));
    return refused;
  }, elsewhere);
  assert.deepEqual([...new Set(tried)].sort(), ['connect-src', 'img-src']);
  // The worker obeys, too.
  const worker = await page.workers()[0].evaluate(async (url) => {
    const refused = new Promise((resolve) =>
      addEventListener('securitypolicyviolation', (event) => resolve(event.effectiveDirective)),
    );
    await fetch(url, { mode: 'no-cors' }).catch(() => {});
    return refused;
  }, elsewhere);
  assert.equal(worker, 'connect-src');
  await close();
});
