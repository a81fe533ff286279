// Reads pairs of paths, a source and what was written of it, one pair a line with a tab between, and prints
// the errors of Khronos' validator that the second has more often than the first.
// Run where `gltf-validator` is installed: node validator.mjs FOLDER PAIRS
import fs from 'node:fs';
import path from 'node:path';
import { createRequire } from 'node:module';

const [folder, list] = process.argv.slice(2);
const validator = createRequire(path.join(path.resolve(folder), 'here.js'))('gltf-validator');

async function errors(file) {
  const beside = (uri) => fs.promises.readFile(path.join(path.dirname(file), decodeURIComponent(uri)));
  const options = { maxIssues: 0, externalResourceFunction: async (uri) => new Uint8Array(await beside(uri)) };
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), options);
  const found = {};
  for (const issue of report.issues.messages.filter((issue) => issue.severity === 0)) {
    (found[issue.code] ??= []).push(`${issue.pointer}: ${issue.message}`);
  }
  return found;
}

for (const line of fs.readFileSync(list, 'utf8').split('\n').filter(Boolean)) {
  const [before, after] = line.split('\t');
  const known = await errors(before);
  for (const [code, places] of Object.entries(await errors(after))) {
    if (places.length > (known[code]?.length ?? 0)) console.log(`${after}: ${code} at ${places[0]}`);
  }
}
