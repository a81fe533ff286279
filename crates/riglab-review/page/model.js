// What is looked at: assets, those of them that the filters let through, the one in focus, what was done.

export const PER_SHEET = 48;
export const NOTHING = Object.freeze({ verdict: "-", category: "", faults: [], comment: "" });

export const assets = [];
export const view = { list: [], at: 0, search: "", show: "all", category: "" };
const done = [];

export const SHOWS = [
  ["all", "everything", () => true],
  ["undecided", "undecided", (a) => a.decision.verdict === "-"],
  ["decided", "decided", (a) => a.decision.verdict !== "-"],
  ["accepted", "accepted", (a) => a.decision.verdict === "accept"],
  ["rejected", "rejected", (a) => a.decision.verdict === "reject"],
  ["kept", "kept by curation", (a) => !a.stage],
  ["dropped", "dropped by curation", (a) => Boolean(a.stage)],
  ["faults", "with faults", (a) => a.decision.faults.length > 0],
  ["comments", "with comments", (a) => a.decision.comment !== ""],
  ["moved", "in another category", (a) => a.decision.category !== "" && a.decision.category !== a.category],
];

export function fill(loaded) {
  loaded.forEach((asset, index) => {
    const text = [asset.name, asset.stage ?? "", asset.reason, ...asset.notes].join("\n").toLowerCase();
    const decision = asset.decision ?? NOTHING;
    // What the server has beside what is shown; and how often another window decided.
    assets.push({ ...asset, index, text, decision, saved: decision, newer: 0 });
  });
}

export const categoryOf = (asset) => asset.decision.category || asset.category;
export const decided = () => assets.filter((a) => a.decision.verdict !== "-").length;
export const current = () => view.list[view.at];
export const sheets = () => Math.max(1, Math.ceil(view.list.length / PER_SHEET));
export const sheet = () => Math.floor(view.at / PER_SHEET);

function passes(asset) {
  const show = SHOWS.find(([key]) => key === view.show) ?? SHOWS[0];
  const words = view.search.toLowerCase().split(/\s+/).filter(Boolean);
  const category = view.category === "" || categoryOf(asset) === view.category;
  return category && show[2](asset) && words.every((word) => asset.text.includes(word) || asset.decision.comment.toLowerCase().includes(word));
}

// Makes the list anew. Decisions alone do not: what was just decided about stays where it is.
export function filter(keep) {
  const held = keep ?? current();
  view.list = assets.filter(passes);
  view.at = Math.max(0, view.list.indexOf(held));
}

// How many of the list no longer pass.
export const stale = () => view.list.filter((asset) => !passes(asset)).length;

export function focus(at) {
  view.at = Math.min(Math.max(at, 0), Math.max(view.list.length - 1, 0));
}

// The next undecided of the list after the one in focus, around its end; -1 where there is none.
export function undecided() {
  const n = view.list.length;
  for (let step = 1; step <= n; step += 1) {
    const at = (view.at + step) % n;
    if (view.list[at].decision.verdict === "-") return at;
  }
  return -1;
}

export const remember = (asset, before) => done.push({ asset, before });
export const forget = (asset, before) => {
  const at = done.findLastIndex((step) => step.asset === asset && step.before === before);
  if (at >= 0) done.splice(at, 1);
};
export const takeBack = () => done.pop();
export const undoable = () => done.length;
