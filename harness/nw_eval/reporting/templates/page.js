"use strict";
// Sorting, filtering, copying and the Escape key: all else, and every word, is there without this script.
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
      const owner = code.closest("tr, li, article");
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

  // On a phone a row is one line, and its name a button that shows the rest; a name that is a link stays one.
  function foldable(row) {
    const head = row.cells[0];
    if (!NARROW.matches || head.querySelector("a, button")) return;
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
    const noun = form.dataset.noun;
    let most = more ? FIRST : Number.POSITIVE_INFINITY;
    const words = new Map([...table.tBodies[0].rows].map((row) => [row, row.textContent.toLowerCase()]));
    const chosen = [...form.querySelectorAll("select")].map((select) => [select, titles.indexOf(select.name)]);
    const value = (cell) => cell.dataset.value ?? cell.textContent;

    function show() {
      const sought = form.words.value.toLowerCase().split(" ").filter(Boolean);
      let found = 0;
      for (const row of table.tBodies[0].rows) {
        const fits =
          chosen.every(([select, column]) => !select.value || value(row.cells[column]) === select.value) &&
          sought.every((word) => words.get(row).includes(word));
        found += fits;
        row.hidden = !fits || found > most;
        if (!row.hidden) {
          foldable(row);
          copyable(row);
        }
      }
      const shown = Math.min(found, most);
      count.textContent = `${found} of ${words.size} ${noun}${shown < found ? `, ${shown} shown` : ""}`;
      if (more) {
        more.hidden = shown === found;
        more.firstElementChild.textContent = NARROW.matches ? `Show ${FIRST} more` : "Show all";
      }
    }

    form.hidden = false;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", show);
    table.addEventListener("sorted", show);
    if (more) {
      more.firstElementChild.addEventListener("click", () => {
        most = NARROW.matches ? most + FIRST : Number.POSITIVE_INFINITY;
        show();
      });
      // Paper has room for all rows that were not filtered away.
      addEventListener("beforeprint", () => { const before = most; most = Number.POSITIVE_INFINITY; show(); most = before; });
      addEventListener("afterprint", show);
    }
    show();
    table.classList.add("ready");
  }

  // Two runs of a table side by side: the columns of all others are hidden, and one has the change.
  function comparable(table) {
    const form = table.closest("section").querySelector("form.pick");
    const heads = [...table.tHead.rows[0].cells];
    if (!form || heads.filter((head) => head.dataset.run).length < 2) return;
    const rows = [...table.rows];
    const change = rows.map((row, place) => {
      const cell = document.createElement(place ? "td" : "th");
      if (!place) cell.scope = "col";
      cell.className = "number change";
      cell.hidden = true;
      row.append(cell);
      return cell;
    });
    change[0].textContent = "change";
    const column = (run) => heads.findIndex((head) => head.dataset.run === run);

    function show() {
      const [first, second] = [form.first.value, form.second.value].map(column);
      const all = second < 0;
      for (const [place, row] of rows.entries()) {
        for (let i = 1; i < heads.length; i++) row.cells[i].hidden = !all && i !== first && i !== second;
        change[place].hidden = all;
        if (place && !all) {
          const [before, after] = [first, second].map((i) => number(row.cells[i].textContent));
          const much = after - before;
          change[place].textContent = Number.isNaN(much) ? "" : `${much > 0 ? "+" : ""}${much.toFixed(3)}`;
        }
      }
    }

    form.hidden = false;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", show);
    show();
  }

  // A count of an outcome, or a scene's name, leads to its trials in the table.
  function leads(link) {
    link.addEventListener("click", () => {
      const form = document.querySelector("form.filter");
      for (const select of form.querySelectorAll("select")) select.value = link.dataset[select.name] ?? "";
      form.words.value = "";
      form.dispatchEvent(new Event("input"));
    });
  }

  // What a link within the page leads to may lie in a part that is folded.
  function unfold() {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let part = target.closest("details"); part; part = part.parentElement.closest("details")) part.open = true;
    if (target.matches(".worst li")) target.scrollIntoView({ block: "center" });
    if (target.matches(".sheet")) target.focus({ preventScroll: true });
  }

  addEventListener("hashchange", unfold);
  addEventListener("keydown", (event) => {
    if (event.key === "Escape") document.querySelector(".sheet:target .close")?.click();
  });
  document.querySelectorAll("a[data-outcome], a[data-scene]").forEach(leads);
  document.querySelectorAll("table[data-compares]").forEach(comparable);
  document.querySelectorAll("table[data-sorts]").forEach(sortable);
  document.querySelectorAll("table[data-filtered]").forEach(filters);
  document.querySelectorAll(".worst, .sheet").forEach(copyable);
  unfold();
})();
