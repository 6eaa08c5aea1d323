"use strict";
for (const select of document.querySelectorAll("select[data-group]")) {
  const shown = document.querySelectorAll(`[data-shows="${select.dataset.group}"]`);
  const show = () => shown.forEach((part) => { part.hidden = part.dataset.key !== select.value; });
  select.parentElement.hidden = false;
  select.addEventListener("change", show);
  show();
}

// Writing to the clipboard may be refused, as in a page opened from a file: then the words are selected, to be copied by hand.
const said = document.getElementById("said");
const select = (button) => {
  getSelection().selectAllChildren(button.previousElementSibling);
  said.textContent = "The command is selected.";
};
for (const button of document.querySelectorAll("button[data-copy]")) {
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(button.dataset.copy);
      said.textContent = "The command is copied.";
      button.textContent = "copied";
      setTimeout(() => { button.textContent = "copy"; }, 1500);
    } catch {
      select(button);
    }
  });
}

// A link to what lies folded up opens it.
const open = () => {
  const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  for (const folded of target.querySelectorAll(":scope > details")) folded.open = true;
  target.scrollIntoView();
};
addEventListener("hashchange", open);
open();
