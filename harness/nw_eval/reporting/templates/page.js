"use strict";
// Sorting, filtering and copying: all else, and every word, is there without this script.
(() => {
  const NARROW = matchMedia("(max-width: 40rem)"); // As in the style sheet.
  const FIRST = NARROW.matches ? 25 : 200; // Rows of a long table that are shown at first.

  const number = (text) => Number.parseFloat(text.replace("over ", ""));

  function compare(column, rising, numeric) {
    const text = (row) => row.cells[column].textContent.trim();
    return (a, b) => {
      let [x, y] = [text(a), text(b)];
      if (x === "" || y === "") return (x === "") - (y === ""); // What is not known comes last.
      const order = numeric ? number(x) - number(y) || 0 : (x > y) - (x < y);
      return rising ? order : -order;
    };
  }

  function sortable(table) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      if (head.tagName !== "TH") return;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const rising = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", rising ? "ascending" : "descending");
        const rows = [...table.tBodies[0].rows];
        rows.sort(compare(column, rising, head.classList.contains("number")));
        table.tBodies[0].append(...rows);
        table.dispatchEvent(new Event("sorted"));
      });
    });
  }

  async function copy(code, button) {
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "copied";
    } catch {
      getSelection().selectAllChildren(code);
      button.textContent = "selected";
    }
    setTimeout(() => (button.textContent = "copy"), 1500);
  }

  function copyable(root) {
    for (const code of root.querySelectorAll("code.copy:not([data-copies])")) {
      const owner = code.closest("tr, li");
      const name = owner ? owner.querySelector("th, h3").textContent : "";
      const button = document.createElement("button");
      button.type = "button";
      button.className = "copies";
      button.textContent = "copy";
      button.setAttribute("aria-label", `copy the replay command of ${name}`);
      button.addEventListener("click", () => copy(code, button));
      code.dataset.copies = "";
      code.after(" ", button);
    }
  }

  // On a phone a row is one line, and its name a button that shows the rest.
  function foldable(row) {
    const head = row.cells[0];
    if (!NARROW.matches || head.querySelector("button")) return;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "plain";
    button.setAttribute("aria-expanded", "false");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      button.setAttribute("aria-expanded", String(row.classList.toggle("whole")));
    });
  }

  function filters(table) {
    const form = document.querySelector("form.filter");
    const more = document.querySelector(".more");
    const count = document.querySelector(".count");
    const titles = [...table.tHead.rows[0].cells].map((cell) => cell.textContent.trim());
    const [scene, outcome] = [titles.indexOf("scene"), titles.indexOf("outcome")];
    let most = FIRST;
    const words = new Map([...table.tBodies[0].rows].map((row) => [row, row.textContent.toLowerCase()]));

    function show() {
      const sought = form.words.value.toLowerCase().split(" ").filter(Boolean);
      let found = 0;
      for (const row of table.tBodies[0].rows) {
        const fits =
          (!form.scene.value || row.cells[scene].textContent === form.scene.value) &&
          (!form.outcome.value || row.cells[outcome].textContent === form.outcome.value) &&
          sought.every((word) => words.get(row).includes(word));
        found += fits;
        row.hidden = !fits || found > most;
        if (!row.hidden) {
          foldable(row);
          copyable(row);
        }
      }
      const shown = Math.min(found, most);
      count.textContent = `${found} of ${words.size} trials${shown < found ? `, ${shown} shown` : ""}`;
      more.hidden = shown === found;
      more.firstElementChild.textContent = NARROW.matches ? `Show ${FIRST} more` : "Show all";
    }

    form.hidden = false;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", show);
    table.addEventListener("sorted", show);
    more.firstElementChild.addEventListener("click", () => {
      most = NARROW.matches ? most + FIRST : Number.POSITIVE_INFINITY;
      show();
    });
    // Paper has room for all rows that were not filtered away.
    addEventListener("beforeprint", () => { const before = most; most = Number.POSITIVE_INFINITY; show(); most = before; });
    addEventListener("afterprint", show);
    show();
    table.classList.add("ready");
  }

  document.querySelectorAll("table[data-sorts]").forEach(sortable);
  const all = document.getElementById("all");
  if (all) filters(all);
  document.querySelectorAll(".worst").forEach(copyable);
})();
