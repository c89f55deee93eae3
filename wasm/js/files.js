/** Files beside these scripts. */

/** Where one of them is, or in Node, whose fetch knows no files, what it holds. @param {URL} url */
export async function beside(url) {
  return url.protocol === 'file:' ? bytes(url) : url;
}

/** What a file holds. @param {URL} url */
export async function bytes(url) {
  if (url.protocol === 'file:') {
    // Not by `import`: bundlers would look for it, and find none for browsers.
    const { readFile } = process.getBuiltinModule('node:fs/promises');
    return new Uint8Array(await readFile(url));
  }
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url.pathname.split('/').at(-1)} could not be loaded (${response.status})`);
  return new Uint8Array(await response.arrayBuffer());
}
