/** Colours that people with any kind of colour vision tell apart (Okabe and Ito; Tol). */
import { colour, current } from "./theme";

// one list a theme: the same hues, light enough or dark enough for the ground they stand on
const LIGHT = ["#0072b2", "#d55e00", "#00855f", "#b8528f", "#a87400", "#3a9bd0", "#4b3f9e", "#8c2d04"];
const DARK = ["#4aa8e0", "#ff8a3d", "#2fc79a", "#ea9fcb", "#f0c04a", "#9ad5f5", "#a79bf0", "#e07b53"];

/** Return the colour of an individual; beyond eight they come again, and numbers tell. */
export function ofIndividual(index: number): string {
  if (index < 0) return colour("muted");
  const list = current() === "dark" ? DARK : LIGHT;
  return list[index % list.length]!;
}

/** Return red, green and blue of a colour like #aabbcc, 0 to 1. */
export function channels(hex: string): [number, number, number] {
  const value = Number.parseInt(hex.slice(1), 16);
  return [(value >> 16) / 255, ((value >> 8) & 255) / 255, (value & 255) / 255];
}

/** Return a colour between two, at a share of 0 to 1. */
export function mix(from: string, to: string, share: number): string {
  const [a, b] = [channels(from), channels(to)];
  const at = (i: number): number => Math.round(255 * (a[i]! + (b[i]! - a[i]!) * share));
  return `rgb(${at(0)}, ${at(1)}, ${at(2)})`;
}

/** Return black or white: what is easier to read on a colour between two (at least 4.5 to 1). */
export function readable(from: string, to: string, share: number): string {
  const [a, b] = [channels(from), channels(to)];
  const linear = [0, 1, 2].map((i) => {
    const value = a[i]! + (b[i]! - a[i]!) * share;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * linear[0]! + 0.7152 * linear[1]! + 0.0722 * linear[2]! > 0.179 ? "#000000" : "#ffffff";
}
