// Bundles the page and its libraries into two files that Python puts into each report.
// `make web` runs it; what it writes is committed. tests/web/test_bundle.py says when that is due.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const OUT = "../mocap_calib/html_report";

/** Licences of what is in the bundle, in full: MIT asks for that. */
function licences(names) {
  const texts = names.map((name) => {
    const { version } = JSON.parse(readFileSync(`node_modules/${name}/package.json`, "utf8"));
    return `${name} ${version}\n\n${readFileSync(`node_modules/${name}/LICENSE`, "utf8").trim()}`;
  });
  return texts.join("\n\n");
}

/** What the bundle was made of: the test holds it to the files. */
function sources() {
  const names = readdirSync("src").filter((name) => !name.endsWith(".d.ts"));
  const paths = ["package.json", "build.mjs", ...names.map((name) => `src/${name}`)].sort();
  const hash = createHash("sha256");
  for (const path of paths) hash.update(readFileSync(path));
  return hash.digest("hex");
}

const banner = (names) => `/*!\nMade by \`make web\` of sources ${sources()}\n\n${licences(names)}\n*/`;
const options = { bundle: true, minify: true, charset: "utf8", legalComments: "none" };

await build({
  ...options,
  entryPoints: ["src/main.ts"],
  outfile: `${OUT}/page.js`,
  format: "iife",
  target: "es2022",
  banner: { js: banner(["three", "uplot"]) },
});
await build({
  ...options,
  entryPoints: ["src/page.css"],
  outfile: `${OUT}/page.css`,
  banner: { css: banner(["uplot"]) },
});

for (const [name, end] of [["page.js", "</script"], ["page.css", "</style"]]) {
  const text = readFileSync(`${OUT}/${name}`, "utf8");
  if (text.toLowerCase().includes(end)) throw new Error(`${name} has ${end}: it would end there`);
  console.log(name, Math.round(text.length / 1024), "KiB");
}
