// Compares the lines of a module of this crate with the golden ones, in whatever runs it.

/** The lines that WebAssembly bytes compute, named like those of `golden`. */
export async function lines(bytes, golden) {
  const { instance } = await WebAssembly.instantiate(bytes, {});
  return golden.trim().split("\n").map((line, index) => {
    const hash = BigInt.asUintN(64, instance.exports.line(index));
    return `${line.split(" ")[0]} ${hash.toString(16).padStart(16, "0")}`;
  });
}

/** Says which line is the first to differ. */
export function compare(found, golden) {
  golden.trim().split("\n").forEach((expected, index) => {
    if (found[index] !== expected) throw new Error(`computes ${found[index]}, every other target ${expected}`);
  });
}

// node stages.mjs MODULE.wasm GOLDEN.txt
if (globalThis.process?.argv[1]?.endsWith("stages.mjs")) {
  const { readFileSync } = await import("node:fs");
  const golden = readFileSync(process.argv[3], "utf8");
  compare(await lines(readFileSync(process.argv[2]), golden), golden);
  console.log(golden.trim());
}
