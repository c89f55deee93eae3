/** The npm package in Node: the README's example, the golden case, and the native fingerprint. */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { copyFileSync, mkdirSync, readFileSync, renameSync, symlinkSync, writeFileSync, existsSync, readdirSync, rmSync } from 'node:fs';
import { createServer } from 'node:http';
import { join } from 'node:path';
import test from 'node:test';
import { fileURLToPath } from 'node:url';
import { gzipSync } from 'node:zlib';
import { validateBytes } from 'gltf-validator';
import sirv from 'sirv';
import { build } from 'vite';
import { DIST, FACE, OUT, PAIR, PHOTOS, goldenSearch, marks, model, native, nativePair, open, run } from './common.mjs';
import { create } from '../dist/js/onescan.js';

const bytes = model();
const modelFile = join(OUT, 'face.3dmm');
writeFileSync(modelFile, bytes);

test('the example of the README runs', { timeout: 120_000 }, async () => {
  const place = join(OUT, 'example');
  rmSync(place, { recursive: true, force: true });
  mkdirSync(join(place, 'node_modules'), { recursive: true });
  symlinkSync(DIST, join(place, 'node_modules/onescan'));
  const readme = readFileSync(join(DIST, 'README.md'), 'utf8');
  const [, code] = /```js\n([\s\S]*?)```/.exec(readme);
  writeFileSync(join(place, 'example.mjs'), code);
  copyFileSync(modelFile, join(place, 'face.3dmm'));
  copyFileSync(join(PHOTOS, 'astronaut.png'), join(place, 'photo.png'));
  const printed = execFileSync('node', ['example.mjs'], { cwd: place, encoding: 'utf8' });
  const { fingerprint, command } = JSON.parse(readFileSync(join(place, 'fit/fit.json'), 'utf8'));
  assert.equal(printed.trim().split('\n').at(-1), fingerprint);
  assert.equal(fingerprint, native(modelFile, 'astronaut.png', [], true).fingerprint);
  assert.match(command, /^onescan fit face.3dmm photo.png --landmarks photo.tlms /);
  for (const name of ['mesh.glb', 'mesh.ply', 'overlay.png', 'behind.png', 'mask.png', 'report.html', 'fit.rps', 'photo.tlms']) {
    assert.ok(existsSync(join(place, 'fit', name)), name);
  }
});

/** An empty project that has installed the packages as npm packs them. */
function project(name) {
  const place = join(OUT, name);
  const modules = join(place, 'node_modules');
  rmSync(place, { recursive: true, force: true });
  mkdirSync(modules, { recursive: true });
  for (const [source, name] of [[DIST, 'onescan'], [FACE, 'onescan-face']]) {
    const [{ filename }] = JSON.parse(execFileSync('npm', ['pack', source, '--json'], { cwd: place, encoding: 'utf8' }));
    execFileSync('tar', ['-xzf', join(place, filename), '-C', modules]);
    renameSync(join(modules, 'package'), join(modules, name));
  }
  return place;
}

test('the types hold in a strict project, and licences are packed', { timeout: 120_000 }, () => {
  const place = project('strict');
  writeFileSync(join(place, 'package.json'), '{ "type": "module" }');
  writeFileSync(join(place, 'example.ts'), `
    import { create, type Face, type Fit, type Fitted, type Landmarks, type Progress, type TracePoint } from 'onescan';
    import { connect } from 'onescan/worker';

    export async function here(model: Uint8Array, photo: Uint8Array): Promise<TracePoint[]> {
      const onescan = await create();
      const job = { model: onescan.model(model), photo: await onescan.photo(photo) };
      const [face]: Face[] = (await onescan.detector()).faces(job.photo);
      const landmarks: Landmarks = face?.landmarks ?? [{ name: 'center.nose.tip', x: 1, y: 2, visible: false }];
      const fit: Fit = onescan.fit({ ...job, landmarks, size: 128 });
      fit.addEventListener('progress', ({ detail }) => {
        const { done, total }: Progress = detail;
        console.log(done / total);
      }, { once: true });
      await fit.run();
      const pixels: Uint8Array = fit.overlay({ behind: true }).rgba();
      const fitted: Fitted = fit.finish({ model: 'a.3dmm', photo: 'a.png' });
      console.log(pixels.length, fitted.files().map(({ name, bytes }) => name + bytes.length));
      // @ts-expect-error There is no such setting.
      onescan.fit({ ...job, landmarks, sizes: 128 });
      return fit.trace;
    }

    export async function there(model: Uint8Array, photo: Uint8Array): Promise<Float32Array | undefined> {
      const client = connect();
      client.addEventListener('progress', ({ detail }) => console.log(detail.trace.at(-1)?.energy, detail.pictures?.mask.width));
      client.addEventListener('other', (event) => console.log(event.type));
      const { landmarks: known }: { landmarks: string[] } = await client.open(model);
      await client.photo(photo);
      const [face] = await client.faces(0);
      const fitted = await client.fit({ landmarks: face?.landmarks ?? [], names: { model: 'a', photo: known.join() } });
      // @ts-expect-error A photo is counted by a number.
      await client.watch('1');
      client.close();
      return fitted && 'shape' in fitted ? fitted.shape : undefined;
    }
  `);
  const compiler = fileURLToPath(new URL('../node_modules/.bin/tsc', import.meta.url));
  const strict = ['--strict', '--noEmit', '--exactOptionalPropertyTypes', '--noUncheckedIndexedAccess', '--target', 'es2022', '--lib', 'es2022,dom'];
  for (const [module, resolution] of [['es2022', 'bundler'], ['nodenext', 'nodenext']]) {
    const how = ['--module', module, '--moduleResolution', resolution, 'example.ts'];
    execFileSync(compiler, [...strict, ...how], { cwd: place, stdio: ['ignore', 'inherit', 'inherit'] });
  }
  const packed = (name) => readFileSync(join(place, 'node_modules/onescan', name), 'utf8');
  assert.match(packed('LICENSE-MIT'), /MIT/);
  assert.match(packed('js/face_mesh/LICENSE'), /Apache License/);
  const notices = packed('LICENSES.txt');
  for (const words of [/MediaPipe/, /^nalgebra v/m, /TERMS AND CONDITIONS/, /Permission is hereby granted/]) assert.match(notices, words);
});

test("a bundler's worker fits as Node does, and one that stopped rejects every call", { timeout: 240_000 }, async (t) => {
  const place = project('bundled');
  const shared = join(place, 'public');
  mkdirSync(shared);
  copyFileSync(join(PHOTOS, 'astronaut.png'), join(shared, 'photo.png'));
  writeFileSync(join(place, 'index.html'), '<!doctype html><title>Bundled</title><script type="module" src="app.js"></script>');
  writeFileSync(join(place, 'app.js'), `
    import { connect } from 'onescan/worker';
    import face from 'onescan-face/face.3dmm?url';
    const load = async (name) => new Uint8Array(await (await fetch(name)).arrayBuffer());
    const tried = async (call) => call.then(() => 'done', (error) => error.message);
    window.fit = async () => {
      const client = connect();
      await client.open(await load(face));
      await client.photo(await load('photo.png'));
      const [{ landmarks }] = await client.faces(0);
      const { fingerprint } = await client.fit({ landmarks, names: { model: 'm', photo: 'p' }, live: false, size: 128 });
      const running = tried(client.fit({ landmarks, names: { model: 'm', photo: 'p' } }));
      client.close();
      return [fingerprint, await running, await tried(client.mean())];
    };
    window.stopped = async () => {
      const line = URL.createObjectURL(new Blob(['setTimeout(() => { throw new Error("sick"); })']));
      const results = [];
      for (const url of [line, '/nothing.js']) {
        const client = connect(new Worker(url));
        for (let call = 0; call < 2; call += 1) results.push(await tried(client.mean()));
      }
      return results;
    };
  `);
  await build({ root: place, configFile: false, logLevel: 'warn' });
  const server = createServer(sirv(join(place, 'dist')));
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  const { browser, close } = await open();
  t.after(async () => {
    await close();
    server.close();
  });
  const page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const [fingerprint, ...closed] = await page.evaluate(() => window.fit());

  const onescan = await create();
  const photo = await onescan.photo(new Uint8Array(readFileSync(join(PHOTOS, 'astronaut.png'))));
  const [{ landmarks }] = (await onescan.detector()).faces(photo);
  const fit = onescan.fit({ model: onescan.model(bytes), photo, landmarks, size: 128 });
  await fit.run();
  assert.equal(fingerprint, fit.fingerprint);

  assert.deepEqual(closed, Array(2).fill('the worker stopped: it was closed'));
  const [first, second, third, fourth] = await page.evaluate(() => window.stopped());
  for (const sick of [first, second]) assert.match(sick, /^the worker stopped: .*sick/);
  for (const lost of [third, fourth]) assert.match(lost, /^the worker stopped: it could not be loaded/);
});

test('a JPEG gives the native fit, run or stepped', { timeout: 120_000 }, async () => {
  const expected = native(modelFile, 'grace_hopper.jpg', ['--size', '128', '--landmark-sd', '3']);
  const onescan = await create();
  const job = {
    model: onescan.model(bytes),
    photo: await onescan.photo(new Uint8Array(readFileSync(join(PHOTOS, 'grace_hopper.jpg')))),
    landmarks: readFileSync(join(PHOTOS, 'grace_hopper.tlms'), 'utf8'),
    size: 128,
    landmarkSd: 3,
  };
  const stepped = onescan.fit(job);
  let made = 0;
  for (let count = 1, last = 1; last > 0; count += 1) made += last = stepped.step(count);
  assert.equal(made, expected.steps);
  assert.equal(stepped.fingerprint, expected.fingerprint);
  const { done, total, ended, converged } = stepped.progress;
  assert.deepEqual([done, ended, converged], [made, true, expected.mode.converged]);
  assert.equal(total, onescan.levels.reduce((sum, { steps }) => sum + steps, 0));
  // Before and after every step.
  assert.deepEqual(stepped.trace.map(({ energy }, i) => [Math.ceil(i / 2), -energy]), expected.trace);
  for (const { level } of stepped.trace) assert.ok(level < onescan.levels.length);

  // The rim of her cap and the glasses are before the face.
  const pictures = [stepped.overlay(), stepped.overlay({ behind: true }), stepped.mask()];
  const [overlay, behind, mask] = pictures.map((picture) => picture.rgba());
  let [hidden, changed] = [0, 0];
  for (let i = 0; i < mask.length; i += 4) {
    const differs = [0, 1, 2].some((c) => overlay[i + c] !== behind[i + c]);
    if (differs) {
      changed += 1;
      hidden += mask[i] < 200;
    }
  }
  assert.ok(changed > 100, `${changed} pixels are before the face`);
  assert.equal(hidden, changed);

  const run = onescan.fit(job);
  let events = 0;
  run.addEventListener('progress', () => {
    events += 1;
    if (events === 2) {
      run.pause();
      setTimeout(() => run.resume(), 30);
    }
  });
  assert.equal(await run.run(), true);
  assert.equal(events, made);
  assert.equal(run.fingerprint, expected.fingerprint);
  const summary = JSON.parse(run.finish().json());
  for (const key of ['parameters', 'mode', 'trace', 'pixel_rmse', 'log_likelihood', 'accepted']) {
    assert.deepEqual(summary[key], expected[key], key);
  }
  const cancelled = onescan.fit(job);
  cancelled.addEventListener('progress', () => cancelled.cancel());
  assert.equal(await cancelled.run(), false);
});

test('two photos of one person give the native fit, and its files', { timeout: 240_000 }, async () => {
  const files = nativePair(modelFile, ['--size', '128']);
  const expected = JSON.parse(files.get('summary.json')).fits;
  const onescan = await create();
  const photo = await Promise.all(PAIR.map((path) => onescan.photo(new Uint8Array(readFileSync(path)))));
  const landmarks = PAIR.map((path) => readFileSync(marks(path), 'utf8'));
  const job = { model: onescan.model(bytes), photo, landmarks, size: 128 };
  const fit = onescan.fit(job);
  assert.equal(fit.photos, 2);
  while (fit.step() > 0);
  assert.equal(fit.fingerprint, expected[0].fingerprint);
  // Each photo is seen by itself.
  for (const show of [(photo) => fit.overlay({ photo }), (photo) => fit.mask(photo)]) {
    const [a, b] = [0, 1].map((number) => show(number).rgba());
    assert.ok(a.some((value, i) => value !== b[i]));
    assert.throws(() => show(2), /no photo of this number/);
  }
  for (const number of [0, 1]) {
    const { origin, size } = expected[number].image.crop;
    assert.deepEqual(fit.crop(number), [...origin, ...size]);
  }
  const names = PAIR.map((path) => path.split('/').at(-1));
  const fitted = fit.finish({ model: 'face.3dmm', photo: names });
  for (const number of [0, 1]) {
    const summary = JSON.parse(fitted.json(number));
    for (const key of ['parameters', 'mode', 'trace', 'pixel_rmse', 'others', 'landmarks', 'fingerprint']) {
      assert.deepEqual(summary[key], expected[number][key], key);
    }
    assert.match(summary.command, /^onescan fit face.3dmm 05_00.jpg 05_30.jpg --landmarks 05_00.tlms 05_30.tlms /);
  }
  const own = new Map(fitted.files().map(({ name, bytes: content }) => [name, content]));
  assert.deepEqual([...own.keys()].sort(), [...files.keys(), ...names.map(marks)].sort());
  for (const name of ['mesh.glb', 'mesh.ply', 'mesh.obj', 'mesh.mtl', 'mesh.png', '05_00/textured.png', '05_00/overlay.png', '05_30/overlay.png', '05_30/fit.rps', '05_30/mask.png']) {
    assert.deepEqual(Buffer.from(own.get(name)), files.get(name), name);
  }
  // An array of one is that one.
  const alone = [{ photo: photo[0], landmarks: landmarks[0] }, { photo: [photo[0]], landmarks: [landmarks[0]] }];
  const [a, b] = alone.map((shown) => {
    const one = onescan.fit({ ...job, ...shown });
    one.step(3);
    return one.fingerprint;
  });
  assert.equal(a, b);
});

test('meshes pass the validator of Khronos, textured or not', { timeout: 240_000 }, async () => {
  const place = join(OUT, 'meshes');
  rmSync(place, { recursive: true, force: true });
  const into = (name) => join(place, name);
  mkdirSync(place, { recursive: true });
  const photo = [join(PHOTOS, 'astronaut.png'), '--landmarks', join(PHOTOS, 'astronaut.tlms'), '--size', '128'];
  for (const texture of ['photo', 'albedo', 'none']) run('fit', modelFile, ...photo, '--texture', texture, '-o', into(texture));
  run('sample', modelFile, '-n', '1', '-o', into('samples'));
  run('modes', modelFile, '-n', '1', '-o', into('modes'));
  run('convert', modelFile, '-o', into('mean.glb'));
  run('model', 'project', modelFile, into('samples/sample_00.ply'), '-o', into('projected.glb'));
  const onescan = await create();
  const [face] = onescan.viewer(onescan.model(bytes)).files();
  writeFileSync(into('face.glb'), face.bytes);
  const meshes = readdirSync(place, { recursive: true }).filter((name) => name.endsWith('.glb'));
  assert.equal(meshes.length, 3 + 1 + 5 + 3);
  for (const name of meshes) {
    const { issues, info } = await validateBytes(new Uint8Array(readFileSync(into(name))));
    assert.equal(issues.numErrors + issues.numWarnings, 0, `${name}: ${JSON.stringify(issues.messages)}`);
    assert.deepEqual(info.extensionsUsed ?? [], name.startsWith('photo') ? ['KHR_materials_unlit'] : [], name);
    assert.equal(info.hasTextures, name.startsWith('photo') || name.startsWith('albedo'), name);
  }
});

test('the full-size golden case', { timeout: 120_000 }, async () => {
  const onescan = await create();
  const fit = onescan.fit({
    model: onescan.model(readFileSync(join(process.env.FULL, 'face.3dmm'))),
    photo: await onescan.photo(new Uint8Array(readFileSync(join(PHOTOS, 'astronaut.png')))),
    landmarks: readFileSync(join(PHOTOS, 'astronaut.tlms'), 'utf8'),
  });
  while (fit.step() > 0);
  assert.equal(fit.fingerprint, goldenSearch('full'));
});

test('faces of a photo are found, the largest first', { timeout: 120_000 }, async () => {
  const onescan = await create();
  const open = (name) => onescan.photo(new Uint8Array(readFileSync(join(PHOTOS, name))));
  const both = [await open('obama.jpg'), await open('grace_hopper.jpg')];
  const width = both[0].width + both[1].width;
  const height = Math.max(both[0].height, both[1].height);
  const data = new Uint8Array(4 * width * height);
  let left = 0;
  for (const photo of both) {
    const rgb = photo.rgb();
    for (let i = 0; i < photo.width * photo.height; i += 1) {
      const at = 4 * (Math.floor(i / photo.width) * width + left + (i % photo.width));
      data.set(rgb.subarray(3 * i, 3 * i + 3), at);
    }
    left += photo.width;
  }
  const detector = await onescan.detector();
  const start = performance.now();
  const [obama, hopper, ...others] = detector.faces(await onescan.photo({ width, height, data }));
  console.log(`faces are found in ${Math.round(performance.now() - start)} ms`);
  assert.equal(others.length, 0);
  assert.ok(obama.size > hopper.size);
  assert.ok(obama.x < both[0].width && hopper.x > both[0].width);
  assert.equal(obama.landmarks.length, 41);
  const marked = new Map(readFileSync(join(PHOTOS, 'grace_hopper.tlms'), 'utf8').trim().split('\n').map((line) => {
    const [name, , x, y] = line.split(' ');
    return [name, [Number(x) + both[0].width, Number(y)]];
  }));
  for (const { name, x, y } of hopper.landmarks) {
    const [tx, ty] = marked.get(name) ?? [x, y];
    assert.ok(Math.hypot(x - tx, y - ty) < 20, `${name}: ${[x, y]}, by hand ${[tx, ty]}`);
  }
  assert.equal(detector.faces(await onescan.photo({ width: 64, height: 64, data: new Uint8Array(64 * 64 * 4) })).length, 0);
});

test('a visitor does not wait for long', () => {
  const size = (path) => gzipSync(readFileSync(join(DIST, path)), { level: 9 }).length;
  // What reads photos and what finds faces are loaded when they are needed.
  const later = /^(onescan_)?(photos|faces)|^sw\./;
  const first = ['', 'js', 'js/wasm', 'page'].flatMap((directory) =>
    readdirSync(join(DIST, directory))
      .filter((name) => /(?<!\.d)\.(html|css|js|svg|wasm)$/.test(name) && !later.test(name))
      .map((name) => join(directory, name)),
  );
  const program = first.reduce((sum, path) => sum + size(path), 0);
  const [photos, finder] = ['photos', 'faces'].map((name) => size(`js/wasm/onescan_${name}_bg.wasm`));
  const face = readFileSync(join(DIST, 'face.3dmm.gz')).length;
  console.log(`gzip: page ${program} bytes, model ${face}, what reads photos ${photos}, what finds faces ${finder}`);
  assert.ok(program <= 350_000);
  assert.ok(face <= 3_000_000);
});

test('what is wrong is said', async () => {
  const onescan = await create();
  const good = onescan.model(bytes);
  const photo = await onescan.photo({ width: 64, height: 64, data: new Uint8Array(64 * 64 * 4) });
  const landmarks = good.landmarks.slice(0, 4).map((name, i) => ({ name, x: 20 + 5 * i, y: 30 + 3 * i }));
  const marked = readFileSync(join(PHOTOS, 'astronaut.tlms'), 'utf8');
  const sides = { left: 'right', right: 'left' };
  const mirrored = marked.replace(/^(left|right)\b/gm, (side) => sides[side]);
  const portrait = await onescan.photo(new Uint8Array(readFileSync(join(PHOTOS, 'astronaut.png'))));
  const damaged = bytes.slice();
  damaged[5000] ^= 1;
  const cases = [
    [() => onescan.model(bytes.subarray(0, 1000)), /bytes/],
    [() => onescan.model(new Uint8Array(99)), /model/],
    [() => onescan.model(damaged), /damaged|checksum/],
    [() => onescan.fit({ model: good, photo, landmarks: [] }), /mark at least 4/],
    [() => onescan.fit({ model: good, photo, landmarks: 'nose 1 2' }), /line 1/],
    [() => onescan.fit({ model: good, photo, landmarks: [{ name: 'nose', x: 1, y: 2 }] }), /no landmark `nose`/],
    [() => onescan.fit({ model: good, photo: portrait, landmarks: mirrored }), /left and right are exchanged/],
    [() => onescan.fit({ model: good, photo, landmarks, size: -1 }), /settings/],
    [() => onescan.fit({ model: good, photo, landmarks, shapeRank: 1000 }), /at most 200/],
    [() => onescan.fit({ model: good, photo, landmarks, size: 1e6 }), /size is 1000000/],
    [() => onescan.fit({ model: good, photo, landmarks, samples: 5 }), /unknown field `samples`/],
    [() => onescan.fit({ model: good, photo: [], landmarks: [] }), /^Error: 0 photos and the landmarks of 0; a fit takes 1 to 8/],
    [() => onescan.fit({ model: good, photo: [photo, photo], landmarks: [marked] }), /2 photos and the landmarks of 1/],
    [() => onescan.fit({ model: good, photo: [photo, photo], landmarks: marked }), /2 photos and the landmarks of 1/],
    [() => onescan.fit({ model: good, photo: Array(9).fill(photo), landmarks: Array(9).fill(landmarks) }), /9 photos/],
    [() => onescan.fit({ model: good, photo: [portrait, photo], landmarks: [marked, 'nose 1 2'] }), /photo 2: line 1/],
    [() => onescan.fit({ model: good, photo: portrait, landmarks: marked }).finish({ photo: ['a', 'b'] }), /a name for each photo/],
  ];
  cases.push(
    [() => onescan.model('face.3dmm'), /as a Uint8Array, not a string: read the file/],
    [() => onescan.fit({ photo, landmarks }), /needs a model of model\(\), not nothing/],
    [() => onescan.fit({ model: good, photo: Promise.resolve(photo), landmarks }), /not a promise: await it/],
    [() => onescan.fit({ model: good, photo }), /needs landmarks/],
    [() => onescan.fit({ model: good, landmarks }), /needs a photo of photo\(\), not nothing/],
  );
  const ended = onescan.fit({ model: good, photo: portrait, landmarks: marked });
  ended.finish();
  for (const late of [() => ended.finish(), () => ended.step(), () => ended.overlay(), () => ended.progress]) {
    cases.push([late, /this fit is finished/]);
  }
  ended.free();
  for (const [wrong, message] of cases) assert.throws(wrong, message);
  await assert.rejects(onescan.photo('photo.png'), /not a string: read the file/);
  await assert.rejects(onescan.photo(new Uint8Array(9)), /PNG or JPEG/);
  await assert.rejects(onescan.photo({ width: 2, height: 2, data: [1] }), /2×2/);
});
