// Store for the contents of a page's data scripts, by run and name; arrays are unpacked to typed arrays.
const store = new Map();
globalThis.cicatrixPut = (letter, name, content) => store.set(`${letter}.${name}`, content);

export const stored = (letter, name) => store.get(`${letter}.${name}`);

const KINDS = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };

export function bytesOf(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

// unpack {type, shape, gzip} as written by cicatrix.pages.packing
export async function unpack(array) {
  const stream = new Blob([bytesOf(array.gzip)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new KINDS[array.type](await new Response(stream).arrayBuffer());
}

export function save(name, content, type) {
  const link = document.createElement("a");
  link.href = content.startsWith?.("data:") ? content : URL.createObjectURL(new Blob([content], { type }));
  link.download = name;
  link.click();
  if (link.href.startsWith("blob:")) setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function csv(head, rows) {
  const cell = (value) => (/[",\n]/.test(String(value)) ? `"${String(value).replaceAll('"', '""')}"` : String(value));
  return [head, ...rows].map((row) => row.map(cell).join(",")).join("\n") + "\n";
}

// number with three significant digits, without trailing zeros
export function short(value) {
  if (!Number.isFinite(value)) return "none";
  return Number(value.toPrecision(3)).toString().replace("-", "\u2212");
}

export const withUnit = (label, unit) => (unit && unit !== "1" ? `${label} [${unit}]` : label);
