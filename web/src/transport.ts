/** Play, step, scrub and speed; and the keys that do the same. */
import { choice, h } from "./dom";
import type { Player } from "./player";
import type { Recording } from "./recording";

const SPEEDS = ["0.1", "0.25", "0.5", "1", "2", "4"];

/** Return the bar below the views. */
export function transport(recording: Recording, player: Player): HTMLElement {
  const play = h("button", { type: "button", class: "play", on: { click: () => player.toggle() } });
  const back = h("button", { type: "button", "aria-label": "One frame back", on: { click: () => player.step(-1) } }, "◂");
  const next = h("button", { type: "button", "aria-label": "One frame on", on: { click: () => player.step(1) } }, "▸");
  const scrub = h("input", {
    type: "range", min: 0, max: player.last, value: 0, "aria-label": "Frame", class: "scrub",
    on: { input: () => { player.pause(); player.seek(Number(scrub.value)); } },
  });
  const where = h("output", { class: "where" });
  const speed = choice("Speed", SPEEDS.map((each) => [each, `${each} ×`] as const), (value) => {
    player.speed = Number(value);
  }, "1");
  const everyone = [["-1", "everyone"] as const];
  const follow = choice("Follow", [...everyone, ...recording.individuals.map((name, i) => [String(i), `individual ${name}`] as const)],
    (value) => player.choose("follow", Number(value)));
  const update = (): void => {
    scrub.value = String(player.index);
    const frame = recording.frames[player.index] ?? 0;
    const seconds = recording.fps ? `, ${((frame - recording.frames[0]!) / recording.fps).toFixed(2)} s` : "";
    where.textContent = `frame ${frame}${seconds}`;
    scrub.setAttribute("aria-valuetext", where.textContent);
  };
  const updatePlay = (): void => {
    play.textContent = player.playing ? "❚❚ Pause" : "▶ Play";
    play.setAttribute("aria-pressed", String(player.playing));
    play.setAttribute("aria-keyshortcuts", "Space");
  };
  player.on((change) => {
    if (change === "frame") update();
    if (change === "playing") updatePlay();
    if (change === "follow") follow.select.value = String(player.follow);
  });
  update();
  updatePlay();
  return h("div", { class: "transport", role: "group", "aria-label": "Player" }, play, back, next, scrub, where, speed.label, follow.label);
}

/** Let space play and arrows step, where no other control wants these keys. */
export function startKeys(player: Player): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    const busy = target.closest("input, select, button, summary, a, textarea, .scroll, .grid-keys");
    if (busy || event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    const actions: Record<string, () => void> = {
      " ": () => player.toggle(),
      ArrowLeft: () => player.step(-1),
      ArrowRight: () => player.step(1),
      Home: () => player.step(-player.last),
      End: () => player.step(player.last),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
}
