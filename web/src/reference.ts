/** The other rig that was laid over this one. */
import { h, section, table } from "./dom";
import { format } from "./number";
import type { Recording } from "./recording";

/** Return a section that says how far the two are apart, or nothing. */
export function referenceSection({ reference, unit }: Recording): HTMLElement | null {
  if (!reference) return null;
  const length = unit === "arbitrary" ? "" : ` ${unit}`;
  const rows = reference.errors.map((error) => h("tr", {},
    h("th", { scope: "row" }, error.name),
    h("td", { class: "n" }, `${format(error.rotation_deg)}°`),
    h("td", { class: "n" }, `${format(error.centre_percent)} %`),
    h("td", { class: "n" }, `${format(error.centre)}${length}`)));
  return section("reference", "Beside the reference", `The rig of ${reference.title}, laid over this one as well as can be; it is grey in the 3D view.`,
    table("How far the cameras of the two rigs are apart", ["Camera", "Turned", "Shifted, of the rig's size", "Shifted"], rows));
}
