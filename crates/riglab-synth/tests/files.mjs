// Prints the errors that Khronos' validator finds in the files of a folder.
// Run where `gltf-validator` is installed: node files.mjs VALIDATOR_FOLDER FOLDER
import fs from 'node:fs';
import path from 'node:path';
import { createRequire } from 'node:module';

const [where, folder] = process.argv.slice(2);
const validator = createRequire(path.join(path.resolve(where), 'here.js'))('gltf-validator');

for (const name of fs.readdirSync(folder).sort()) {
  const bytes = new Uint8Array(fs.readFileSync(path.join(folder, name)));
  const report = await validator.validateBytes(bytes, { maxIssues: 0 });
  for (const issue of report.issues.messages.filter((issue) => issue.severity === 0)) {
    console.log(`${name}: ${issue.code} at ${issue.pointer}: ${issue.message}`);
  }
}
