// Keys, buttons and what they do.

import * as server from "./server.js";
import * as model from "./model.js";
import * as sheet from "./sheet.js";
import * as detail from "./detail.js";

const $ = (id) => document.getElementById(id);
let categories = [];
let faults = [];

const KEYS = [
  ["\u2190 \u2191 \u2192 \u2193", "another asset"], ["Page Up, Page Down", "another sheet"], ["Home, End", "the first, the last"],
  ["A", "accept, and go on"], ["R", "reject, and go on"], ["O", "leave open: the stages decide"],
  ["1 to 8", "category; the same key again clears it"], ["F", "faults of the skeleton"], ["C", "comment"],
  ["U", "undo"], ["N", "next undecided"], ["/", "search"], ["G", "refresh the list: drop what no longer passes the filters"], ["?", "these keys"],
];

function draw(takeFocus) {
  if (!sheet.isDrawn()) sheet.draw(act);
  sheet.mark(takeFocus);
  detail.draw(act);
  const [decided, all, shown] = [model.decided(), model.assets.length, model.view.list.length];
  $("bar").max = Math.max(all, 1);
  $("bar").value = decided;
  $("tally").textContent = `${decided} of ${all} decided`;
  $("shown").textContent = shown === all ? "" : `${shown} shown`;
  const stale = model.stale();
  $("again").hidden = stale === 0;
  $("again").textContent = `${stale} no longer match: refresh the list (G)`;
  const { search, show, category } = model.view;
  const at = model.current()?.name ?? "";
  history.replaceState(null, "", `#${new URLSearchParams({ search, show, category, at })}`);
}

// What is shown of an asset with a change; nothing where it changes nothing.
function changed(asset, change) {
  const after = { ...asset.decision, ...change };
  return JSON.stringify(after) === JSON.stringify(asset.decision) ? undefined : after;
}

// Takes a decision: shown at once. Where it cannot be saved, what the server has is shown again, unless a later decision about
// the asset is on its way, which holds all of this one. What another window decided meanwhile is shown instead.
async function decide(asset, change, undoing) {
  const before = asset.decision;
  const after = changed(asset, change);
  if (!after) return;
  asset.decision = after;
  if (!undoing) model.remember(asset, before);
  sheet.update(asset);
  $("status").textContent = "saving";
  try {
    await server.decide(asset, after);
    if ("comment" in change) lost.delete(asset);
    complain("");
    if (server.pending() <= 1) $("status").textContent = "saved";
  } catch (fault) {
    const shown = asset.decision === after;
    if (fault.newer || shown) {
      asset.decision = asset.saved;
      if (!undoing) model.forget(asset, before);
      // It can be tried again.
      else if (!fault.newer) model.remember(asset, change);
    }
    $("status").textContent = "not saved";
    if (fault.newer && change.comment) lost.set(asset, change.comment);
    complain(fault.message);
    sheet.update(asset);
    draw(false);
  }
}

// Comments that another window's decisions kept from being saved, until the next about the asset is.
const lost = new Map();

function complain(text) {
  const kept = [...lost].map(([asset, comment]) => `Your comment about ${asset.name} was: ${comment}`);
  $("alert").textContent = [text, ...kept].filter(Boolean).join(" ");
  $("alert").hidden = $("alert").textContent === "";
}

function go(at) {
  saveComment();
  model.focus(at);
  draw(true);
}

const act = {
  look(asset) {
    go(model.view.list.indexOf(asset));
  },
  verdict(asset, verdict) {
    saveComment();
    model.focus(model.view.list.indexOf(asset));
    decide(asset, { verdict });
    if (verdict !== "-" && model.view.at + 1 < model.view.list.length) model.focus(model.view.at + 1);
    draw(true);
  },
  category(category) {
    const asset = model.current();
    if (!asset || category === undefined) return;
    decide(asset, { category: asset.decision.category === category ? "" : category });
    draw(false);
  },
  fault(fault) {
    const asset = model.current();
    if (!asset) return;
    const had = asset.decision.faults;
    const now = had.includes(fault) ? had.filter((f) => f !== fault) : [...had, fault];
    decide(asset, { faults: now });
    draw(false);
  },
};

// Of the asset it was typed about, which may not be in focus any more.
function saveComment() {
  const asset = detail.commented();
  if (asset && document.activeElement === $("comment")) decide(asset, { comment: $("comment").value.trim() });
}

function undo() {
  let step = model.takeBack();
  // What was never saved is undone already.
  while (step && !changed(step.asset, step.before)) step = model.takeBack();
  if (!step) return;
  if (!model.view.list.includes(step.asset)) {
    Object.assign(model.view, { search: "", show: "all", category: "" });
    showFilters();
    model.filter(step.asset);
  }
  model.focus(model.view.list.indexOf(step.asset));
  decide(step.asset, step.before, true);
  draw(true);
}

function next() {
  const at = model.undecided();
  if (at < 0) $("status").textContent = "nothing here is undecided";
  else go(at);
}

function listAnew() {
  model.filter();
  draw(true);
}

function addFault() {
  const own = $("fault-own").value.replaceAll(",", " ").trim();
  if (own && !model.current()?.decision.faults.includes(own)) act.fault(own);
  $("fault-own").value = "";
}

function turn(sheets) {
  go((model.sheet() + sheets) * model.PER_SHEET);
}

const COMMANDS = {
  ArrowLeft: () => go(model.view.at - 1),
  ArrowRight: () => go(model.view.at + 1),
  ArrowUp: () => { if (model.view.at >= sheet.columns()) go(model.view.at - sheet.columns()); },
  ArrowDown: () => { if (model.view.at + sheet.columns() < model.view.list.length) go(model.view.at + sheet.columns()); },
  PageUp: () => turn(-1),
  PageDown: () => { if (model.sheet() + 1 < model.sheets()) turn(1); },
  Home: () => go(0),
  End: () => go(model.view.list.length - 1),
  a: () => model.current() && act.verdict(model.current(), "accept"),
  r: () => model.current() && act.verdict(model.current(), "reject"),
  o: () => model.current() && act.verdict(model.current(), "-"),
  f: () => model.current() && $("faults-menu").showModal(),
  c: () => model.current() && $("comment").focus(),
  u: undo,
  n: next,
  g: listAnew,
  "/": () => $("search").select(),
  "?": () => $("help").showModal(),
};

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if ($("help").open) return;
  if (event.target.matches("input, textarea, select")) return;
  if ($("faults-menu").open) {
    const fault = /^[1-9]$/.test(key) ? faults[Number(key) - 1] : undefined;
    if (fault) { event.preventDefault(); act.fault(fault); }
    return;
  }
  const command = /^[1-8]$/.test(key) ? () => act.category(categories[Number(key) - 1]) : COMMANDS[key];
  if (!command || (event.repeat && !key.startsWith("Arrow"))) return;
  event.preventDefault();
  command();
}

function onComment(event) {
  if (event.key === "Escape" || (event.key === "Enter" && !event.shiftKey)) {
    event.preventDefault();
    if (event.key === "Escape") $("comment").value = detail.commented()?.decision.comment ?? "";
    saveComment();
    draw(true);
  }
}

function showFilters() {
  $("search").value = model.view.search;
  $("show").value = model.view.show;
  $("category").value = model.view.category;
}

function onFilter(event) {
  Object.assign(model.view, { search: $("search").value, show: $("show").value, category: $("category").value });
  model.filter();
  draw(false);
  event.stopPropagation();
}

function option(value, text) {
  const made = sheet.element("option", "", text);
  made.value = value;
  return made;
}

// A word of a command, as a shell reads it.
function quoted(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
}

async function begin() {
  const loaded = await server.load();
  ({ categories, faults } = loaded);
  document.title = `${loaded.title} \u00b7 riglab review`;
  $("title").textContent = loaded.title;
  $("decisions").textContent = loaded.decisions;
  $("command").textContent = `riglab curate FOLDER -o ${quoted(loaded.corpus)} --decisions ${quoted(loaded.decisions)}`;
  $("keys").replaceChildren(...KEYS.flatMap(([keys, what]) => {
    const term = sheet.element("dt");
    term.append(sheet.element("kbd", "", keys));
    return [term, sheet.element("dd", "", what)];
  }));
  $("show").replaceChildren(...model.SHOWS.map(([value, text]) => option(value, text)));
  $("category").replaceChildren(option("", "all"), ...categories.map((name) => option(name, name)));
  detail.prepare(categories, faults, act);
  model.fill(loaded.assets);
  const kept = new URLSearchParams(location.hash.slice(1));
  for (const key of ["search", "show", "category"]) model.view[key] = kept.get(key) ?? model.view[key];
  model.filter(model.assets.find((asset) => asset.name === kept.get("at")));
  showFilters();
  if (loaded.told.length > 0) complain(loaded.told.join(". "));
  const n = loaded.unreadable;
  if (n > 0) $("status").textContent = `${n} ${n === 1 ? "file" : "files"} could not be read: see the curation's report`;
  draw(true);
}

document.addEventListener("keydown", onKey);
for (const button of document.querySelectorAll(".row [data-verdict]")) {
  button.addEventListener("click", () => act.verdict(model.current(), button.dataset.verdict));
}
$("comment").addEventListener("keydown", onComment);
$("comment").addEventListener("blur", () => {
  const asset = detail.commented();
  if (asset) decide(asset, { comment: $("comment").value.trim() });
});
$("search").addEventListener("input", onFilter);
$("search").addEventListener("keydown", (event) => { if (["Enter", "Escape"].includes(event.key)) draw(true); });
$("show").addEventListener("change", onFilter);
$("category").addEventListener("change", onFilter);
$("again").addEventListener("click", listAnew);
$("back").addEventListener("click", () => turn(-1));
$("forth").addEventListener("click", () => turn(1));
$("undo").addEventListener("click", undo);
$("next").addEventListener("click", next);
$("faults-open").addEventListener("click", COMMANDS.f);
$("fault-add").addEventListener("click", addFault);
$("fault-own").addEventListener("keydown", (event) => { if (event.key === "Enter") { event.preventDefault(); addFault(); } });
$("help-open").addEventListener("click", COMMANDS["?"]);
for (const id of ["faults-menu", "help"]) $(id).addEventListener("close", () => draw(true));
addEventListener("pagehide", saveComment);
addEventListener("beforeunload", (event) => { if (server.pending() > 0) event.preventDefault(); });
begin().catch((fault) => complain(`The assets cannot be shown: ${fault.message}`));
