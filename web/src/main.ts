/** Builds the page of the report's data. */
import { bodiesSection } from "./bodies";
import { camerasSection } from "./cameras";
import type { ReportData } from "./data";
import { h, type Child } from "./dom";
import { setRun } from "./number";
import { pairsSection } from "./pairs";
import { Player } from "./player";
import { provenanceSection } from "./provenance";
import { read, type Recording } from "./recording";
import { referenceSection } from "./reference";
import type { Json } from "./run";
import { theatre } from "./theatre";
import { themeSwitch } from "./theme";
import { timelineSection } from "./timeline";
import { startTooltip } from "./tooltip";
import { startKeys } from "./transport";
import { toneOf, mark, verdictSection } from "./verdict";

const USUAL_RATE = 30;

function header(recording: Recording, sections: HTMLElement[]): HTMLElement {
  const { run, title } = recording;
  const links = sections.map((each) => h("li", {}, h("a", { href: `#${each.id}` }, each.querySelector("h2")?.textContent ?? each.id)));
  return h("header", { class: "top" },
    h("a", { class: "skip", href: "#main" }, "Skip to the report"),
    h("div", { class: "title" },
      h("h1", {}, h("span", { class: "kind" }, "Calibration report"), h("span", { class: "name" }, title)),
      h("span", { class: `verdict-chip ${toneOf(run.verdict.rig)}` }, mark(toneOf(run.verdict.rig)), run.verdict.rig),
      themeSwitch()),
    h("nav", { "aria-label": "Parts of the report" }, h("ul", {}, ...links)));
}

function footer({ run }: Recording): HTMLElement {
  return h("footer", {}, `mocap-calib ${run.version} · this file needs no network and sends nothing`);
}

/** Return the first frame in which about as many joints are seen as ever. */
function firstFull({ frames, individuals, joints, points }: Recording): number {
  const counts = new Int32Array(frames.length);
  const stride = 3 * joints.length;
  for (let i = 0; i < points.length; i += 3) {
    if (points[i] === points[i]) counts[Math.floor(i / stride) % frames.length]!++;
  }
  const most = counts.reduce((high, count) => Math.max(high, count), 0);
  return individuals.length ? Math.max(0, counts.findIndex((count) => count >= 0.95 * most)) : 0;
}

/** Build the page. */
function show(root: HTMLElement, recording: Recording): void {
  setRun(recording.run as unknown as Json);
  const player = new Player(recording.frames, recording.breaks, recording.fps ?? USUAL_RATE);
  player.seek(firstFull(recording));
  const sections: Child[] = [
    verdictSection(recording),
    theatre(recording, player),
    timelineSection(recording, player),
    camerasSection(recording, player),
    pairsSection(recording),
    bodiesSection(recording, player),
    referenceSection(recording),
    provenanceSection(recording),
  ];
  const shown = sections.filter((each): each is HTMLElement => each instanceof HTMLElement);
  root.replaceChildren(header(recording, shown), h("main", { id: "main", tabindex: -1 }, ...shown), footer(recording));
  startTooltip(root);
  startKeys(player);
  document.documentElement.dataset.ready = "yes";
}

async function start(): Promise<void> {
  const root = document.getElementById("app");
  const data = document.getElementById("report-data");
  if (!root || !data) return;
  try {
    show(root, await read(JSON.parse(data.textContent ?? "") as ReportData));
  } catch (error) {
    root.replaceChildren(h("main", {}, h("h1", {}, "This report cannot be shown"), h("p", {}, String(error)),
      h("p", {}, "run.json beside it has all numbers.")));
    throw error;
  }
}

void start();
