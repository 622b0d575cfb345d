// Validates the glTF files named on standard input, one a line, and writes one JSON object:
// path -> list of "CODE pointer message" of its errors.
import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { validateBytes } from "gltf-validator";

const report = {};
for (const path of readFileSync(0, "utf8").split("\n").filter(Boolean)) {
  const beside = async (uri) => new Uint8Array(readFileSync(join(dirname(path), decodeURIComponent(uri))));
  const result = await validateBytes(new Uint8Array(readFileSync(path)), {
    uri: path,
    externalResourceFunction: beside,
  });
  const errors = result.issues.messages.filter((issue) => issue.severity === 0);
  report[path] = errors.map((issue) => `${issue.code} ${issue.pointer ?? ""} ${issue.message}`);
}
process.stdout.write(JSON.stringify(report));
