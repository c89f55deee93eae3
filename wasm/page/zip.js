/** Many files as one: a ZIP archive without compression, folders by the files' names. */

/** @typedef {{ name: string, bytes: Uint8Array<ArrayBuffer> }} File */

/** Names are UTF-8. */
const FLAGS = 0x0800;
/** The first of January 1980, where its time begins. */
const DATE = 0x21;
/** Its checksum (CRC-32) of each byte. */
const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let crc = byte;
  for (let bit = 0; bit < 8; bit += 1) crc = (crc >>> 1) ^ (0xedb88320 & -(crc & 1));
  return crc;
});

/**
 * The archive.
 * @param {File[]} files
 */
export function zip(files) {
  /** @type {Uint8Array<ArrayBuffer>[]} */
  const parts = [];
  /** @type {Uint8Array<ArrayBuffer>[]} */
  const directory = [];
  let offset = 0;
  for (const { name, bytes } of files) {
    const path = new TextEncoder().encode(name);
    const { length } = bytes;
    // What both headers of a file have in common: 16-bit numbers, then 32-bit ones.
    const common = [...words(20, FLAGS, 0, 0, DATE), ...longs(checksum(bytes), length, length), ...words(path.length, 0)];
    directory.push(Uint8Array.of(...longs(0x02014b50), ...words(20), ...common, ...words(0, 0, 0), ...longs(0, offset)), path);
    parts.push(Uint8Array.of(...longs(0x04034b50), ...common), path, bytes);
    offset += 30 + path.length + length;
  }
  const size = directory.reduce((sum, { length }) => sum + length, 0);
  const { length } = files;
  const end = Uint8Array.of(...longs(0x06054b50), ...words(0, 0, length, length), ...longs(size, offset), ...words(0));
  return new Blob([...parts, ...directory, end]);
}

/** @param {Uint8Array} bytes */
function checksum(bytes) {
  let crc = -1;
  for (const byte of bytes) crc = (crc >>> 8) ^ TABLE[(crc ^ byte) & 255];
  return ~crc;
}

/** Bytes of 16-bit numbers, the lowest first. @param {number[]} values */
const words = (...values) => values.flatMap((value) => [value, value >>> 8]);
/** Of 32-bit numbers. @param {number[]} values */
const longs = (...values) => values.flatMap((value) => words(value, value >>> 16));
