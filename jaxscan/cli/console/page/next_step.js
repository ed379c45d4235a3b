// The next step.
import { inUse, twoDigits } from "/calibration.js";
import { isOld, maker } from "/captures.js";

const WAITS = {
  calibrate: "The calibration is calculated: wait for its verdict.", recalibrate: "The calibration is bettered: wait for its verdict.",
  reconstruct: "The cloud is calculated; it can be looked at as soon as that is done.",
};

// In words, and the one green button for it, by its id or as [capture, button].
export function nextStep(state, operates) {
  if (!operates) return ["", ""];
  if (state.doing === "placing") return ["", "take"];
  if (state.doing === "aim") {
    const { exposure, proof } = state.live ?? {};
    if (proof || !exposure) return ["", ""];
    if (exposure.do.startsWith("expose")) return ["Press Auto: it finds the exposure for what is seen now.", "auto"];
    const well = exposure.do ? `Better: ${exposure.do}. Then` : "The line is good:";
    return state.calibration || !state.has_board ? [`${well} Scan.`, "sweep"] : [`${well} Calibrate, with the board.`, "boards"];
  }
  if (state.doing !== "nothing") return ["", ""];
  const work = state.works.find((work) => work.running), waits = WAITS[work?.what.split(" ")[0]];
  if (waits) return [`${waits} ${work.lines.at(-1)?.match(/about .* left$/)?.[0] ?? ""}`, ""];
  if (resumable(state)) return [`Resume goes on with ${state.order.name}.`, "resume"];
  const made = state.captures.find((capture) => capture.cloud);
  const before = made && isOld(made, state) && maker(made, state), used = inUse(state);
  if (before?.sigma_mm < used?.sigma_mm) return [`${used.file} is used now: ${twoDigits(used.sigma_mm)} mm. ${before.file}, with which ${made.name} was made, is good to ${twoDigits(before.sigma_mm)} mm: if the rig is as it was, choose it under Calibration. If not, Scan.`, "sweep"];
  if (made && isOld(made, state)) return [`Reconstruct ${made.name} again: its cloud was made with another calibration than the one that is used now.`, [made.name, "Reconstruct"]];
  const tried = made && ((state.verdict?.of ?? []).includes(made.name) || state.works.some((work) => work.what === `recalibrate ${made.name}`));
  const better = made && state.calibration && !tried ? " Recalibrate betters the calibration by it." : "";
  if (made) return [`${made.name} has its cloud: Look around, under Captures, or Scan again.${better}`, [made.name, "Look around"]];
  if (!state.calibration && state.verdict?.verdict) return ["This calibration is not used: its verdict below says what to do.", "boards"];
  if (!state.calibration) return [`First Look, until the line is bright and sharp; then ${state.has_board ? "Calibrate, with the board" : "Scan"}.`, !state.live ? "aim" : state.has_board ? "boards" : "sweep"];
  const swept = state.captures.find((capture) => capture.kind === "sweep" && capture.complete);
  if (swept) return [`Reconstruct ${swept.name}, under Captures, makes its cloud.`, [swept.name, "Reconstruct"]];
  return ["Take the board out of the room; then Scan.", "sweep"];
}

export const resumable = (state) => Boolean(state.order) && state.order.do !== "aim" && state.done < state.planned && known(state) && !known(state).complete;
const known = (state) => state.captures.find((capture) => capture.name === state.order.name);
