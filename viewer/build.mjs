// Bundle the libraries and the viewer's scripts into the assets of the Python package; --check tests whether they are up to date.
import { build } from "esbuild";
import { existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const assets = join(here, "..", "src", "cicatrix", "pages", "assets");
const shared = { bundle: true, write: false, absWorkingDir: here, target: "es2022", charset: "ascii", logLevel: "warning" };

async function outputs() {
  const libraries = await build({
    ...shared, entryPoints: ["src/libraries.js"], format: "iife", globalName: "cicatrixLibraries", minify: true,
    legalComments: "none", metafile: true, define: { "process.env.NODE_ENV": '"production"' },
  });
  const viewer = await build({ ...shared, entryPoints: ["src/main.js"], format: "iife" });
  return {
    "libraries.js": libraries.outputFiles[0].text,
    "viewer.js": viewer.outputFiles[0].text,
    "LICENCES.txt": licences(Object.keys(libraries.metafile.inputs)),
  };
}

// name, version, licence and licence text of every package with a file in the bundle
function licences(inputs) {
  const folders = new Set();
  for (const input of inputs) {
    const parts = input.split("node_modules/");
    if (parts.length < 2) continue;
    const [scope, name] = parts.at(-1).split("/");
    folders.add([...parts.slice(0, -1), scope.startsWith("@") ? `${scope}/${name}` : scope].join("node_modules/"));
  }
  const blocks = [...folders].sort().map((folder) => {
    const path = join(here, folder);
    const about = JSON.parse(readFileSync(join(path, "package.json"), "utf8"));
    const licence = typeof about.license === "string" ? about.license : (about.license?.type ?? about.licenses?.[0]?.type ?? "");
    if (!licence || /GPL/.test(licence.replace(/LGPL[^ )]*/g, "GPL"))) throw new Error(`${folder}: licence ${licence || "unknown"}`);
    const file = readdirSync(path).find((name) => /^(licen[cs]e|copying)/i.test(name));
    const text = file ? readFileSync(join(path, file), "utf8").trim() : `(no licence file; package.json says ${licence})`;
    return `${about.name} ${about.version}: ${licence}\n\n${text}\n`;
  });
  const head = "Libraries that the pages of cicatrix use to draw, bundled into libraries.js, with their licences.\n\n";
  return (head + blocks.join(`\n${"-".repeat(78)}\n\n`)).replace(/\r\n/g, "\n").replace(/[ \t]+$/gm, "");
}

const made = await outputs();
let stale = 0;
for (const [name, text] of Object.entries(made)) {
  const path = join(assets, name);
  if (!process.argv.includes("--check")) writeFileSync(path, text);
  else if (!existsSync(path) || readFileSync(path, "utf8") !== text) {
    console.error(`${name} is not what viewer/ builds: run "npm run build" in viewer/ and commit the result`);
    stale = 1;
  }
}
process.exit(stale);
