// The contact sheet. Names and reasons come from files: they are set as text, never as markup.

import { picture } from "./server.js";
import { PER_SHEET, categoryOf, current, sheet, sheets, view } from "./model.js";

const $ = (id) => document.getElementById(id);
const WORDS = { accept: "\u2713 accepted", reject: "\u2717 rejected" };
let drawn = null;

export function element(name, className, text) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

// Draws the sheet that the asset in focus is on.
export function draw(act) {
  const first = sheet() * PER_SHEET;
  const cards = view.list.slice(first, first + PER_SHEET).map((asset) => card(asset, act));
  if (cards.length === 0) cards.push(element("li", "empty", "No asset passes these filters."));
  $("sheet").replaceChildren(...cards);
  $("sheet").scrollTop = 0;
  drawn = { list: view.list, sheet: sheet() };
  $("page").textContent = `Sheet ${sheet() + 1} of ${sheets()}`;
  $("back").disabled = sheet() === 0;
  $("forth").disabled = sheet() + 1 >= sheets();
}

export const isDrawn = () => drawn !== null && drawn.list === view.list && drawn.sheet === sheet();

function card(asset, act) {
  const item = element("li", "card");
  item.dataset.index = asset.index;
  item.tabIndex = -1;
  const plate = element("div", "plate");
  if (asset.picture) {
    const image = element("img");
    image.loading = "lazy";
    image.decoding = "async";
    image.alt = `Skeleton and parts of ${asset.name}`;
    image.src = picture(asset.index, "small");
    image.addEventListener("error", () => { plate.classList.add("none"); plate.textContent = "no picture"; });
    plate.append(image);
  } else {
    plate.classList.add("none");
    plate.textContent = "Not in the corpus. Start with --files and the curated folder to see it.";
  }
  const text = element("div", "text");
  const title = element("span", "title", asset.name);
  title.title = asset.name;
  const quick = element("span", "quick");
  for (const [verdict, sign, label] of [["accept", "\u2713", "Accept"], ["reject", "\u2717", "Reject"]]) {
    const button = element("button", "", sign);
    button.type = "button";
    button.tabIndex = -1;
    button.title = label;
    button.setAttribute("aria-label", `${label} ${asset.name}`);
    button.addEventListener("click", (event) => { event.stopPropagation(); act.verdict(asset, verdict); });
    quick.append(button);
  }
  const line = element("div", "line");
  line.append(element("span", "kind"), quick);
  text.append(title, line, element("div", "tags"));
  item.append(plate, text);
  item.addEventListener("click", () => act.look(asset));
  show(item, asset);
  return item;
}

function show(item, asset) {
  const { verdict, faults, comment, category } = asset.decision;
  item.classList.toggle("accept", verdict === "accept");
  item.classList.toggle("reject", verdict === "reject");
  const kind = item.querySelector(".kind");
  kind.textContent = categoryOf(asset) || "no category";
  kind.classList.toggle("changed", category !== "" && category !== asset.category);
  const tags = [];
  if (verdict !== "-") tags.push(element("span", `tag ${verdict}`, WORDS[verdict]));
  if (asset.stage) tags.push(element("span", "tag dropped", `dropped: ${asset.stage}`));
  if (faults.length > 0) tags.push(element("span", "tag fault", `${faults.length} fault${faults.length > 1 ? "s" : ""}`));
  if (comment) tags.push(element("span", "tag note", "comment"));
  item.querySelector(".tags").replaceChildren(...tags);
  const said = [asset.name, kind.textContent, ...tags.map((tag) => tag.textContent)];
  item.setAttribute("aria-label", said.join(", "));
}

const itemOf = (asset) => $("sheet").querySelector(`[data-index="${asset.index}"]`);

// Shows what was decided about an asset, if it is on the sheet.
export function update(asset) {
  const item = itemOf(asset);
  if (item) show(item, asset);
}

// Marks the asset in focus and brings it into sight.
export function mark(takeFocus) {
  for (const old of $("sheet").querySelectorAll("[aria-current]")) {
    old.removeAttribute("aria-current");
    old.tabIndex = -1;
  }
  const asset = current();
  const item = asset && itemOf(asset);
  if (!item) return;
  item.setAttribute("aria-current", "true");
  item.tabIndex = 0;
  if (takeFocus) item.focus({ preventScroll: true });
  item.scrollIntoView({ block: "nearest" });
}

export const columns = () => getComputedStyle($("sheet")).gridTemplateColumns.split(" ").length;
