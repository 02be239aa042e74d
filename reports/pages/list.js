// The list of segments: 50 rows at a time of those in #rows, by class and take, sorted by a click on a head.
(() => {
  const source = document.getElementById("rows"), box = document.getElementById("list");
  if (!source || !box) return;
  const { takes, rates, classes, slots, subclasses, rows } = JSON.parse(source.textContent);
  const size = 50;
  const [byClass, byTake, count, page, back, on, head, body] =
    ["select.class", "input.take", ".count", ".page", ".back", ".on", "thead tr", "tbody"].map(name => box.querySelector(name));
  const seconds = (row, at) => row[at] / rates[row[0]];
  const number = (value, digits) => value === null ? "–" : value.toFixed(digits);
  const columns = [
    ["take", row => takes[row[0]], row => takes[row[0]], true],
    ["class", row => classes[row[1]], row => classes[row[1]], true],
    ...(rows.some(row => classes[row[1]] !== subclasses[row[2]]) ? [["as", row => subclasses[row[2]], row => subclasses[row[2]], true]] : []),
    ["from, s", row => seconds(row, 3), row => seconds(row, 3).toFixed(2)],
    ["to, s", row => seconds(row, 4), row => seconds(row, 4).toFixed(2)],
    ["length, s", row => seconds(row, 4) - seconds(row, 3), row => (seconds(row, 4) - seconds(row, 3)).toFixed(2)],
    ["confidence", row => row[5], row => number(row[5], 2)],
    ["cost", row => row[6], row => number(row[6], 3)],
  ];
  if (rows.some(row => row[9] !== null)) columns.push(["other method", row => row[9] ?? "", row => row[9] ?? "agrees", true]);
  if (rows.some(row => row[10] !== null)) columns.push(["ground truth", row => row[10], row => row[10] === null ? "–" : row[10] ? "confirmed" : "false", true]);
  let chosen = rows, first = 0, sorted = columns.findIndex(([name]) => name === "confidence"), rising = true;

  for (const [place, name] of classes.map((name, place) => [place, name]).sort((a, b) => a[1].localeCompare(b[1]))) byClass.add(new Option(name, place));
  columns.forEach(([name, , , text], place) => {
    const cell = document.createElement("th"), button = document.createElement("button");
    cell.scope = "col";
    if (text) cell.className = "text";
    button.textContent = name;
    cell.append(button);
    head.append(cell);
    button.addEventListener("click", () => {
      rising = sorted === place ? !rising : true;
      sorted = place;
      choose();
    });
  });
  head.insertAdjacentHTML("beforeend", '<th scope="col" class="text">motion</th>');

  function choose() {
    const part = byTake.value.trim().toLowerCase(), value = columns[sorted][1];
    chosen = rows.filter(row => (byClass.value === "" || row[1] === +byClass.value) && takes[row[0]].toLowerCase().includes(part));
    chosen.sort((one, other) => {
      const a = value(one), b = value(other);
      if (a === null || b === null) return (a === null) - (b === null);
      return (rising ? 1 : -1) * (typeof a === "string" ? a.localeCompare(b) : a - b);
    });
    [...head.cells].forEach((cell, place) => place === sorted ? cell.setAttribute("aria-sort", rising ? "ascending" : "descending") : cell.removeAttribute("aria-sort"));
    first = 0;
    show();
  }

  function show() {
    body.replaceChildren(...chosen.slice(first, first + size).map(row => {
      const line = document.createElement("tr");
      columns.forEach(([name, , text, left]) => {
        const cell = line.insertCell();
        if (left) cell.className = "text";
        if (name === "class") { const dot = document.createElement("i"); dot.className = `dot k${slots[row[1]]}`; cell.append(dot); }
        cell.append(text(row));
      });
      const cell = line.insertCell();
      cell.className = "text";
      if (row[7]) {
        const button = document.createElement("button");
        button.className = "see";
        button.textContent = "play";
        Object.assign(button.dataset, { take: takes[row[0]], start: row[3], stop: row[4], what: classes[row[1]] });
        if (row[8] !== null) button.dataset.near = row[8];
        cell.append(button);
      } else cell.append("–");
      return line;
    }));
    count.textContent = chosen.length === rows.length ? "" : `${chosen.length.toLocaleString("en")} of ${rows.length.toLocaleString("en")}`;
    page.textContent = chosen.length ? `${(first + 1).toLocaleString("en")}–${Math.min(first + size, chosen.length).toLocaleString("en")} of ${chosen.length.toLocaleString("en")}` : "none";
    back.disabled = first === 0;
    on.disabled = first + size >= chosen.length;
  }

  byClass.addEventListener("change", choose);
  byTake.addEventListener("input", choose);
  back.addEventListener("click", () => { first -= size; show(); });
  on.addEventListener("click", () => { first += size; show(); });
  box.hidden = false;
  choose();
})();
// The archive: the take under the pointer, and a playhead.
(() => {
  const source = document.getElementById("places");
  if (!source) return;
  const places = JSON.parse(source.textContent), plots = document.querySelectorAll("svg.whole");
  const at = new Map(places.map(place => [place[0], place]));
  for (const plot of plots) {
    const readout = plot.closest(".archive").querySelector(".readout");
    plot.addEventListener("pointermove", event => {
      const { left, width } = plot.getBoundingClientRect(), x = 100 * (event.clientX - left) / width;
      const place = places.find(([, start, length]) => start <= x && x < start + length);
      readout.textContent = place ? place[0] : "";
    });
  }
  const heads = [...plots].map(plot => {
    const line = document.createElementNS(plot.namespaceURI, "path");
    line.setAttribute("class", "playhead");
    plot.append(line);
    return line;
  });
  document.addEventListener("playhead", ({ detail }) => {
    const [, left, width] = at.get(detail.take) ?? [];
    const d = left === undefined ? "" : `M${10 * (left + width * detail.frame / detail.frames)} 0v10`;
    for (const line of heads) line.setAttribute("d", d);
  });
  document.addEventListener("playend", () => { for (const line of heads) line.setAttribute("d", ""); });
})();
