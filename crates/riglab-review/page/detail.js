// The asset that is looked at, at the side of the sheet.

import { picture } from "./server.js";
import { current, undoable, view } from "./model.js";
import { element } from "./sheet.js";

const $ = (id) => document.getElementById(id);
let shown = null;
let later;

// Whose comment is in the field.
export const commented = () => shown;

// Puts the buttons of categories and faults there, once.
export function prepare(categories, faults, act) {
  $("categories").replaceChildren(...categories.map((category, index) => {
    const button = choice(String(index + 1), category);
    button.dataset.category = category;
    button.addEventListener("click", () => act.category(category));
    return button;
  }));
  $("faults-list").replaceChildren(...faults.map((fault, index) => {
    const button = choice(String(index + 1), fault);
    button.dataset.fault = fault;
    button.addEventListener("click", () => act.fault(fault));
    return button;
  }));
}

function choice(key, text) {
  const button = element("button");
  button.type = "button";
  button.append(element("kbd", "", key), ` ${text}`);
  return button;
}

export function draw(act) {
  const asset = current();
  $("detail").hidden = !asset;
  if (!asset) return;
  if (shown !== asset) {
    shown = asset;
    $("name").textContent = asset.name;
    $("large").parentElement.hidden = !asset.picture;
    $("large").removeAttribute("src");
    clearTimeout(later);
    // Whoever walks on at once needs no picture.
    later = setTimeout(enlarge, 80, asset, view.list[view.at + 1]);
    $("detail").scrollTop = 0;
    facts(asset);
  }
  const { verdict, category, faults, comment } = asset.decision;
  fate(asset);
  for (const button of document.querySelectorAll(".row [data-verdict]")) {
    button.setAttribute("aria-pressed", String(button.dataset.verdict === verdict));
  }
  for (const button of $("categories").children) {
    const own = button.dataset.category;
    button.setAttribute("aria-pressed", String(own === category));
    button.classList.toggle("guess", own === asset.category);
  }
  for (const button of $("faults-list").children) {
    button.setAttribute("aria-pressed", String(faults.includes(button.dataset.fault)));
  }
  $("faults").replaceChildren(...faults.map((fault) => {
    const chip = element("button", "tag fault", `${fault} \u00d7`);
    chip.type = "button";
    chip.title = "Take this mark away";
    chip.addEventListener("click", () => act.fault(fault));
    return chip;
  }));
  if (document.activeElement !== $("comment")) $("comment").value = comment;
  $("undo").disabled = undoable() === 0;
}

function enlarge(asset, next) {
  if (!asset.picture) return;
  $("large").alt = `Skeleton and parts of ${asset.name}`;
  $("large").src = picture(asset.index, "large");
  // The next one is drawn while this one is looked at.
  if (next?.picture) new Image().src = picture(next.index, "large");
}

// What the next build does with it.
function fate(asset) {
  const { verdict } = asset.decision;
  const was = asset.stage ? `Dropped by curation (${asset.stage}): ${asset.reason}.` : "Kept.";
  const will = {
    accept: asset.stage ? " The next build keeps it." : "",
    reject: asset.stage ? "" : " The next build drops it.",
    "-": "",
  };
  $("fate").textContent = was + will[verdict];
  $("fate").classList.toggle("dropped", Boolean(asset.stage));
}

function facts(asset) {
  const words = [["joint", "joints"], ["vertex", "vertices"], ["triangle", "triangles"]];
  const counts = asset.counts.map((n, k) => `${n.toLocaleString("en")} ${words[k][n === 1 ? 0 : 1]}`);
  const label = asset.category ? ` \u00b7 ${asset.category} by ${asset.by || "the corpus"}` : "";
  $("facts").textContent = counts.join(" \u00b7 ") + label;
  $("notes").replaceChildren(...asset.notes.map((note) => element("li", "", note)));
}
