// The reference decoders of compressed geometry, in WebAssembly.
//
// One JSON request a line, one reply a line, as python/serve.py does it.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

// Packages lie in a folder of their own, not beside this file.
const require = createRequire(process.env.RIGLAB_NODE_MODULES + "/");
const draco3d = require("draco3d");
const { MeshoptDecoder } = require("meshoptimizer");

const draco = await draco3d.createDecoderModule();
await MeshoptDecoder.ready;

// Corners and attributes of a compressed primitive, as arrays of this language.
function decodeDraco(bytes, attributes) {
  const decoder = new draco.Decoder();
  const mesh = new draco.Mesh();
  try {
    const status = decoder.DecodeArrayToMesh(bytes, bytes.length, mesh);
    if (!status.ok()) throw new Error(status.error_msg());
    const corners = 3 * mesh.num_faces();
    const at = draco._malloc(4 * corners);
    decoder.GetTrianglesUInt32Array(mesh, 4 * corners, at);
    const parts = [new Uint32Array(draco.HEAPU32.buffer, at, corners).slice()];
    draco._free(at);
    for (const number of attributes) {
      const attribute = decoder.GetAttributeByUniqueId(mesh, number);
      const count = mesh.num_points() * attribute.num_components();
      const to = draco._malloc(4 * count);
      decoder.GetAttributeDataArrayForAllPoints(mesh, attribute, draco.DT_FLOAT32, 4 * count, to);
      parts.push(new Float32Array(draco.HEAPF32.buffer, to, count).slice());
      draco._free(to);
    }
    return parts;
  } finally {
    draco.destroy(mesh);
    draco.destroy(decoder);
  }
}

function decodeMeshopt(bytes, { count, byteStride, mode, filter }) {
  const target = new Uint8Array(count * byteStride);
  MeshoptDecoder.decodeGltfBuffer(target, count, byteStride, bytes, mode, filter ?? "NONE");
  return [target];
}

// A number that depends on every byte decoded, so that both sides can be compared.
function sum(parts) {
  let total = 0;
  for (const part of parts) for (const value of part) total += value;
  return total;
}

let chunks = [];

const handlers = {
  // Chunks to decode: [{file, draco: [attribute, ...]} or {file, meshopt: {...}}, ...]
  load({ chunks: list }) {
    chunks = list.map((chunk) => ({ ...chunk, bytes: new Uint8Array(readFileSync(chunk.file)) }));
    return chunks.length;
  },
  decode({ times }) {
    const start = performance.now();
    let parts = [];
    for (let i = 0; i < times; i++) {
      parts = chunks.map((c) => (c.draco ? decodeDraco(c.bytes, c.draco) : decodeMeshopt(c.bytes, c.meshopt)));
    }
    return { seconds: (performance.now() - start) / 1e3, sum: sum(parts.flat()) };
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  let reply;
  try {
    reply = { ok: handlers[request.do](request) };
  } catch (e) {
    reply = { error: String(e).split("\n")[0] };
  }
  process.stdout.write(JSON.stringify(reply) + "\n");
}
