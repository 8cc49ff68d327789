/** Bones, height and speed of the bodies over time. */
import { Chart, values, type Curve } from "./charts";
import { choice, h, section, table } from "./dom";
import { percent } from "./pairs";
import { ofIndividual } from "./palette";
import type { Player } from "./player";
import { median, type Recording } from "./recording";

function nameOf(recording: Recording, edge: number): string {
  const [a, b] = recording.edges[edge]!;
  return `${recording.joints[a]} – ${recording.joints[b]}`;
}

/** Return the lengths of a bone over time. */
function lengths({ series, edges }: Recording, individual: number, edge: number): (number | null)[] {
  const n = series.bins.length;
  const at = (individual * edges.length + edge) * n;
  return values(series.bones, at, at + n);
}

/** Return the usual length of a bone, and by what share it varies (median absolute deviation). */
function steadiness(all: (number | null)[]): [number, number] {
  const known = all.filter((each): each is number => each !== null);
  const usual = median(known);
  return [usual, (1.4826 * median(known.map((each) => Math.abs(each - usual)))) / usual];
}

function boneTable(recording: Recording, individual: number, chosen: number, choose: (edge: number) => void): HTMLElement {
  const unit = recording.unit === "arbitrary" ? "" : ` ${recording.unit}`;
  const rows = recording.edges.map((_, edge) => {
    const [usual, spread] = steadiness(lengths(recording, individual, edge));
    return h("tr", { class: edge === chosen ? "chosen" : "" },
      h("th", { scope: "row" }, h("button", { type: "button", class: "link", "aria-pressed": edge === chosen, on: { click: () => choose(edge) } }, nameOf(recording, edge))),
      h("td", { class: "n" }, Number.isFinite(usual) ? `${Number(usual.toPrecision(3))}${unit}` : "–"),
      h("td", { class: spread > 0.15 ? "n warn" : "n" }, percent(spread)));
  });
  return table("Bones: usual length, and by what share it varies over time", ["Bone", "Length", "Varies"], rows, "tight");
}

class Bodies {
  readonly element: HTMLElement;
  private individual = 0;
  private edge: number;
  private readonly bones: Chart;
  private readonly list = h("div", { class: "boned" });
  private readonly select: HTMLSelectElement;

  constructor(private readonly recording: Recording, player: Player) {
    this.bones = new Chart(player);
    this.edge = this.longest();
    const list = choice("Individual", recording.individuals.map((name, i) => [String(i), `individual ${name}`] as const), (value) => this.choose(Number(value)));
    this.select = list.select;
    this.element = h("div", {},
      h("div", { class: "bar" }, list.label),
      h("div", { class: "split bones" }, h("div", {}, h("h3", {}, "Lengths of bones"), this.bones.element,
        h("p", { class: "small" }, "A bone does not change its length: where it seems to, joints are wrong, or the rig is.")), this.list));
    player.on((change) => change === "follow" && player.follow >= 0 && this.choose(player.follow));
    this.show();
  }

  /** Return the bone of the first individual that is longest: it tells most. */
  private longest(): number {
    const usual = this.recording.edges.map((_, edge) => steadiness(lengths(this.recording, 0, edge))[0] || 0);
    return Math.max(0, usual.indexOf(Math.max(...usual)));
  }

  private choose(individual: number): void {
    this.individual = individual;
    this.select.value = String(individual);
    this.show();
  }

  private show(): void {
    const { recording, edge, individual } = this;
    const others = recording.individuals.length <= 8 ? recording.individuals.map((_, i) => i) : [individual];
    const unit = recording.unit === "arbitrary" ? "" : ` ${recording.unit}`;
    this.bones.show({
      title: `Length of ${nameOf(recording, edge)} over time, by individual`,
      frames: recording.series.bins, unit,
      curves: others.map((i): Curve => ({
        label: `individual ${recording.individuals[i]}`, colour: () => ofIndividual(i), values: lengths(recording, i, edge), width: i === individual ? 2.4 : 1.1,
      })),
    });
    this.list.replaceChildren(boneTable(recording, individual, edge, (to) => {
      this.edge = to;
      this.show();
      this.list.querySelectorAll<HTMLElement>("button")[to]?.focus();
    }));
  }
}

/** Return one curve for each individual. */
function each(recording: Recording, numbers: ArrayLike<number>): Curve[] {
  const n = recording.series.bins.length;
  return recording.individuals.map((name, i) => ({ label: `individual ${name}`, colour: () => ofIndividual(i), values: values(numbers, i * n, (i + 1) * n) }));
}

/** Return the second part of the fifth section. */
export function bodiesSection(recording: Recording, player: Player): HTMLElement {
  const { individuals, series, edges, fps, unit } = recording;
  const lead = "Lengths of bones, height and speed tell a biologist at a glance whether the bodies are plausible.";
  if (!individuals.length || !edges.length) return section("bodies", "Bodies", "No body was triangulated.");
  const length = unit === "arbitrary" ? "arbitrary length" : unit;
  const legend = individuals.length <= 8;
  const height = new Chart(player);
  const speed = new Chart(player);
  if (series.height) height.show({ title: "Height of the highest joint above the floor", frames: series.bins, unit: unit === "arbitrary" ? "" : ` ${unit}`, curves: each(recording, series.height), legend });
  const time = fps ? "second" : "frame";
  speed.show({ title: "Speed of the trunk", frames: series.bins, unit: "", curves: each(recording, series.speed), legend });
  return section("bodies", "Bodies", lead,
    new Bodies(recording, player).element,
    h("div", { class: "halves" },
      h("div", {}, h("h3", {}, `Height above the floor (${length})`), series.height ? height.element : h("p", { class: "none" }, "No floor is known, so there is no height.")),
      h("div", {}, h("h3", {}, `Speed (${length} per ${time})`), speed.element)));
}

