// Which calibration is used, and how good it is.
import { at, fill, make } from "/shared.js";

function age(seconds) {
  const [each, name] = [[86400, "day"], [3600, "hour"], [60, "minute"]].find(([each]) => seconds >= each) ?? [1, ""];
  const count = Math.floor(seconds / each);
  return name ? `${count} ${name}${count === 1 ? "" : "s"} ago` : "just now";
}

// By the user's own goal; a colour without one would judge what nobody asked for.
const judged = (size, state) => (!state.goal_mm || !size ? "" : size <= state.goal_mm ? "good" : "open");

export const inUse = (state) => (state.calibrations ?? []).find((one) => state.calibration && state.calibration.split("/").at(-1) === one.file);

// The calibration that is used, and those that may be used instead. Its verdict is said once.
export function showCalibration(state, operates) {
  const known = state.calibrations ?? [], used = inUse(state);
  const made = used ? age(Date.now() / 1000 - used.changed) : "", below = used && state.verdict?.verdict?.headline === used.headline;
  at("calibration").textContent = !state.calibration ? "none yet: the cloud grows once there is one" : !used ? state.calibration : below ? `made ${made}` : `${used.headline}; ${made}`;
  at("calibration").className = used && !below ? judged(used.sigma_mm, state) : "";
  const some = known.filter((one) => one.good), list = at("calibrations");
  list.hidden = !some.length;
  list.disabled = !operates;
  const words = (one) => [one.sigma_mm && `${twoDigits(one.sigma_mm)} mm`, one.file, age(Date.now() / 1000 - one.changed)].filter(Boolean).join(", ");
  const key = JSON.stringify([some.map(words), used?.file]);
  if (list.dataset.shown === key || document.activeElement === list) return;
  list.dataset.shown = key;
  fill(list, [...(used?.good ? [] : [make("option", state.calibration ?? "choose one")]), ...some.map((one) => { const made = make("option", words(one)); made.value = one.file; return made; })]);
  list.value = used?.file ?? list.options[0]?.value;
}

export function showVerdict(state) {
  const { verdict } = state;
  at("verdict").hidden = !verdict?.verdict;
  if (!verdict?.verdict) return;
  const own = judged(verdict.sigma_mm, state), kinds = { good: own, plain: own, bad: "wrong", open: "open" };
  at("headline").textContent = `${verdict.so_far ? `${verdict.so_far} so far: ` : ""}${verdict.verdict.headline}`;
  at("headline").className = `headline ${kinds[verdict.verdict.kind] ?? ""}`;
  at("goal").textContent = !verdict.sigma_mm ? "" : state.goal_mm ? `Your goal_mm is ${state.goal_mm}: ${verdict.sigma_mm <= state.goal_mm ? "met" : "not met"}.` : `Write goal_mm into ${state.config} to have it judged.`;
  at("explanation").textContent = verdict.verdict.explanation;
  fill(at("lengths"), (verdict.lengths ?? []).map((length) => {
    const row = make("tr", undefined, length.part ? "part" : "");
    row.append(make("td", `± ${twoDigits(length.sigma_mm)} mm`), make("td", length.what));
    return row;
  }));
  fill(at("next-steps"), [...(verdict.warnings ?? []), ...(verdict.advice ?? [])].map((text) => make("li", text)));
}

export const twoDigits = (size) => (size >= 10 ? size.toFixed(0) : size.toPrecision(2));
