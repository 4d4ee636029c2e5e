// The workbench: display and editing of a layout.

const $ = (id) => document.getElementById(id);
const workbench = { layout: null, chosen: { part: null, row: 0 }, past: [], future: [], result: null, milliseconds: 0, dragging: false, other: null, own: {} };
const caches = new Map();
// Vessels are closed where pressure changes the blood by less than this part of the most.
const CLOSED = 0.02;
/** Whether a resolution of a force on a finger [N] is below half of the prior's standard deviation, above which it is no information. */
const isKnown = (value, { touch } = ownFinger, force = workbench.layout.force) => value < 0.5 * touch.prior_pa * Math.hypot(...atForce(touch.force_per_pa, force));
/** Why no force is resolved on the scene's finger, as words to add; nothing where it is. */
function whyNone(result) {
  const { force } = workbench.layout, { touch } = ownFinger, rows = result.rows.filter((row) => !row.few);
  if (isKnown(resolutionOf(result).value, ownFinger)) return "";
  if (!rows.length) return ": too few photons";
  if (rows.every((row) => row.saturated)) return ": every reading is saturated";
  const closed = ["proximal", "distal"].filter((_, zone) => {
    const change = (table) => Math.abs(table[zone][zone]);
    return change(atForce(touch.blood_per_pa, force)) < CLOSED * Math.max(...touch.blood_per_pa.map(change));
  });
  return closed.length ? `: at ${+force.toFixed(3)} N the vessels of the ${closed.join(" and ")} bed are closed, and more force changes no reading` : ": the readings do not tell both sides from each other";
}
const resolutionOf = (result) => (tables.touch.has_body ? result.throughBody : result.electronics);

// ---- words and numbers

/** A value with its standard error in one unit, to two digits of the error. */
function withError(value, error, unit, factor = 1) {
  const x = value * factor, e = error * factor;
  if (!Number.isFinite(x) || !Number.isFinite(e)) return `– ${unit}`;
  const digits = e > 0 ? Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(e)))) : 3;
  return `${x.toFixed(digits).replace("-", "−")} ± ${e.toFixed(digits)} ${unit}`.trim();
}

/** A value and its standard error in the same unit, each by itself. */
function both(value, error, unit) {
  const [factor, prefix] = prefixOf(value), words = withError(value, error, "", factor).split(" ± ");
  return [`${words[0]} ${prefix}${unit}`, words[1] ? `± ${words[1]}` : ""];
}

function prefixOf(value) {
  return [[1, ""], [1e3, "m"], [1e6, "µ"], [1e9, "n"], [1e12, "p"]].find(([f]) => Math.abs(value) * f >= 1) || [1, ""];
}

function say(text) {
  $("message").textContent = text;
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { $("message").textContent = ""; }, 12000);
}

function element(name, attributes = {}, ...children) {
  const svg = ["g", "rect", "line", "text", "path", "clipPath"].includes(name);
  const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// ---- state

function copy(layout) { return structuredClone(layout); }

/** Keep the layout as it was before a change, for undo, and the address up to date. */
function remember(before) {
  workbench.past.push(before);
  if (workbench.past.length > 200) workbench.past.shift();
  workbench.future = [];
  workbench.other = null;
  history.replaceState(null, "", `#${toLink(workbench.layout)}`);
}

/** The scene's own parts under the force, blood and light that the page shows. */
const ownLayout = () => ({ ...workbench.layout, leds: copy(tables.layout.leds), photodiodes: copy(tables.layout.photodiodes) });
const isOwn = () => JSON.stringify([workbench.layout.leds, workbench.layout.photodiodes]) === JSON.stringify([tables.layout.leds, tables.layout.photodiodes]);

/** What the scene's own layout reads, for comparison. */
function ownResult() {
  const { force, rest, so2, ambient } = workbench.layout, key = JSON.stringify([force, rest, so2, ambient]);
  if (workbench.own.key !== key) workbench.own = { key, result: evaluate(ownLayout(), caches) };
  return workbench.own.result;
}

/** Show the scene's own layout, or again the one that was shown before it. */
function showOther() {
  const shown = copy(workbench.layout), other = workbench.other || ownLayout(), back = workbench.other !== null;
  change((layout) => Object.assign(layout, { leds: other.leds, photodiodes: other.photodiodes }));
  workbench.other = back ? null : shown;
  draw();
}

/** Change the layout where it keeps its rules; say why not where it does not. */
function change(edit) {
  const before = workbench.layout, after = copy(before);
  edit(after);
  try {
    workbench.layout = checkedLayout(after);
    remember(before);
  } catch (error) { say(`${error.message}.`); }
  draw();
}

function step(from, to) {
  if (!from.length) return;
  to.push(copy(workbench.layout));
  workbench.layout = from.pop();
  workbench.other = null;
  history.replaceState(null, "", `#${toLink(workbench.layout)}`);
  draw();
}

/** Reference of the footprint of which a part is one die of several, as U1 of U1.red; empty of others. */
const moduleOf = ({ reference }) => (reference || "").split(".").slice(0, -1).join(".");
const isWith = (part, other) => part.name === other.name || (moduleOf(part) !== "" && moduleOf(part) === moduleOf(other));

/** Bring a part to a place and angle; dies of one module keep their places beside each other. */
function movePart(layout, name, { u, v, turn }) {
  const parts = [...layout.leds, ...layout.photodiodes], { ...from } = parts.find((part) => part.name === name);
  const angle = ((turn - from.turn) * Math.PI) / 180, [c, s] = [Math.cos(angle), Math.sin(angle)];
  for (const part of parts.filter((one) => isWith(one, from))) {
    const [x, y] = [part.u - from.u, part.v - from.v];
    Object.assign(part, { u: +(u + c * x - s * y).toFixed(4), v: +(v + s * x + c * y).toFixed(4), turn: (part.turn + turn - from.turn) % 360 });
  }
}

const allParts = () => [...workbench.layout.leds.map((part) => ["led", part]), ...workbench.layout.photodiodes.map((part) => ["diode", part])];
const chosenPart = () => allParts().find(([, part]) => part.name === workbench.chosen.part) || null;

// ---- the board

function drawBoard() {
  const svg = $("board"), [width, length] = tables.board.nailMm, { layout } = workbench, margin = 0.9;
  svg.setAttribute("viewBox", `${-width / 2 - margin} ${-length / 2 - margin} ${width + 2 * margin} ${length + 2 * margin + 0.7}`);
  const focused = document.activeElement && document.activeElement.dataset ? document.activeElement.dataset.name : null;
  svg.replaceChildren();
  // v points to the tip, which is up; a picture's y points down.
  const edge = -tables.board.zoneEdgeMm, round = 0.4;
  const outline = `M${-width / 2} ${length / 2} V${-length / 2 + round} Q${-width / 2} ${-length / 2} ${-width / 2 + round} ${-length / 2} H${width / 2 - round} Q${width / 2} ${-length / 2} ${width / 2} ${-length / 2 + round} V${length / 2} Z`;
  svg.append(element("path", { class: "nail", d: outline }));
  const blood = atForce(tables.touch.blood, layout.force);
  svg.append(element("clipPath", { id: "nail-shape" }, element("path", { d: outline })));
  const clip = element("g", { "clip-path": "url(#nail-shape)" });
  [[blood[0], edge, length / 2], [blood[1], -length / 2, edge]].forEach(([part, top, bottom]) => clip.append(element("rect", {
    class: "zone", x: -width / 2, y: top, width, height: bottom - top, opacity: Math.min(0.8, 0.34 * part) })));
  svg.append(clip);
  const [uMin, uMax, vMin, vMax] = tables.board.outline, wall = tables.board.wall;
  const border = tables.board.border.length ? tables.board.border : [[[uMin, vMin], [uMax, vMin], [uMax, vMax], [uMin, vMax]]];
  svg.append(element("path", { class: "outline", d: border.map((line) => `M${line.map(([u, v]) => `${u} ${-v}`).join("L")}Z`).join("") }));
  if (wall) svg.append(element("rect", { class: "wall", x: wall.uMin, y: -wall.vMax, width: wall.uMax - wall.uMin, height: wall.vMax - wall.vMin }));
  const row = workbench.result && workbench.result.rows[workbench.chosen.row];
  if (row) {
    const led = layout.leds[row.led];
    svg.append(element("line", { class: "pair", x1: led.u, y1: -led.v, x2: row.element.u, y2: -row.element.v }));
  }
  for (const [kind, part] of allParts()) svg.append(drawPart(kind, part, row));
  if (workbench.dragging) drawSeparations(svg);
  svg.append(element("line", { class: "scale-line", x1: -1, x2: 1, y1: length / 2 + 0.75, y2: length / 2 + 0.75 }));
  const words = [["tip", -length / 2 - 0.3], ["2 mm", length / 2 + 1.25]];
  for (const [text, y] of words) svg.append(element("text", { class: "scale", x: 0, y }, text));
  if (focused) { const again = [...svg.querySelectorAll(".part")].find((one) => one.dataset.name === focused); if (again) again.focus({ preventScroll: true }); }
}

/** Lines from the dragged part to the nearest others, with their lengths. */
function drawSeparations(svg) {
  const [, moved] = chosenPart(), others = allParts().map(([, part]) => part).filter((part) => part.name !== moved.name);
  for (const [separation, from, to] of separations(moved, others).slice(0, 3)) {
    svg.append(element("line", { class: "separation", x1: from[0], y1: -from[1], x2: to[0], y2: -to[1] }));
    svg.append(element("text", { class: "separation", x: (from[0] + to[0]) / 2, y: -(from[1] + to[1]) / 2 }, `${separation.toFixed(2)} mm`));
  }
}

function drawPart(kind, part, row) {
  const selected = part.name === workbench.chosen.part ? " selected" : "", reach = 0.35;
  const group = element("g", { class: `part ${kind}${selected}`, tabindex: 0, role: "button", "data-name": part.name, "data-kind": kind,
    "aria-label": `${kind === "led" ? "LED" : "photodiode"} ${part.name} at ${part.u.toFixed(2)}, ${part.v.toFixed(2)} mm` });
  const turned = (shape, { u, v, turn }) => { shape.setAttribute("transform", `translate(${u} ${-v}) rotate(${(-turn * 180) / Math.PI})`); return shape; };
  const rectangle = (name, { width, length }, more = 0) => element("rect", { class: name, x: -width / 2 - more, y: -length / 2 - more, width: width + 2 * more, height: length + 2 * more, rx: more ? 0.15 : 0 });
  if (kind === "led") {
    const die = dieOf(part), far = Math.max(die.width, die.length) / 2;
    for (let i = 0; i < 8; i++) {
      const angle = (i * Math.PI) / 4, [c, s] = [Math.cos(angle), Math.sin(angle)];
      group.append(element("line", { class: "ray", x1: part.u + c * (far + 0.12), y1: -part.v + s * (far + 0.12), x2: part.u + c * (far + 0.28), y2: -part.v + s * (far + 0.28) }));
    }
    group.append(turned(rectangle("die", die), die), turned(rectangle("grip", die, reach), die));
    // Names of LEDs side by side stand above and below them in turn.
    const near = workbench.layout.leds.filter((one) => Math.abs(one.u - part.u) < 1.8 && Math.abs(one.v - part.v) < 0.8);
    const turn = near.findIndex((one) => one.name === part.name), off = far + 0.42 + 0.45 * Math.floor(turn / 2);
    group.append(element("text", { x: part.u, y: turn % 2 ? off + 0.3 - part.v : -part.v - off }, part.name));
    return group;
  }
  const all = elementsOf(part, false), read = new Set(elementsOf(part).map((one) => one.name));
  for (const one of all) {
    const picked = row && row.element.name === one.name ? " picked" : "";
    group.append(turned(rectangle(read.has(one.name) ? `die${picked}` : "unread", one), one));
  }
  const pitch = part.pitch || part.length, whole = { width: part.width, length: (part.elements - 1) * pitch + part.length };
  const at = { u: part.u, v: part.v, turn: (part.turn * Math.PI) / 180 };
  group.append(turned(rectangle("grip", whole, Math.max(0.08, reach - Math.min(whole.width, whole.length) / 2)), at));
  const edge = box(all);
  // Beside it, where there is more room to the board's edge.
  const right = edge.uMax < tables.board.nailMm[0] / 2 - 2;
  group.append(element("text", { x: right ? edge.uMax + 0.2 : edge.uMin - 0.2, y: -part.v + 0.14, style: `text-anchor: ${right ? "start" : "end"}` }, part.name));
  return group;
}

// ---- numbers beside it

function drawCards() {
  const { result, layout } = workbench, row = result.rows[workbench.chosen.row], cards = [];
  const resolution = (one) => (isKnown(one.value) ? both(one.value, one.error, "N") : ["None", ""]);
  cards.push([...resolution(resolutionOf(result)), `force resolution of one sample (Cramér-Rao bound), ${tables.touch.has_body ? "with physiological noise" : "limited by the electronics"}${whyNone(result)}`]);
  if (!isOwn()) cards.push([...resolution(resolutionOf(ownResult())), "the same of the scene's own layout"]);
  const { prefix, cells } = commonUnit(result.people.map(resolutionOf), (one, i) => isKnown(one.value, people[i])), some = cells.some(([, error]) => error);
  cards.push([some ? cells.map(([number]) => number).join(" · ") : "None", some ? `${prefix}N` : "", `the same for people at the ${people.map((person) => 100 * person.quantile).join(", ")} % quantiles`, "narrow"]);
  if (tables.touch.has_body) cards.push([...resolution(result.electronics), "limited by the electronics alone"]);
  if (row) {
    const name = `${layout.leds[row.led].name} on ${row.element.name}`;
    if (row.few) cards.push(["Too few photons", "", name]);
    else {
      cards.push([...(row.saturated ? ["Saturated", ""] : both(row.volts, row.voltsError, "V")), `${name}, now${row.saturated ? whySaturated(row) : ""}`]);
      cards.push([...(row.saturated ? ["None", ""] : both(row.change, row.changeError, "V")), `${name}, change under ${+layout.force.toFixed(3)} N${row.interpolated[1] ? "; ± is mostly interpolation" : ""}`]);
      cards.push([`${(100 * row.directShare).toFixed(0)} %`, "", "of that light is shunted: it bypassed the bed"]);
    }
  }
  $("cards").replaceChildren(...cards.map(([number, small, words, name = ""]) => {
    const item = element("li", { class: /\d/.test(number) ? name : `${name} weak` }), big = element("b", {}, number);
    if (small) big.append(" ", element("small", {}, small));
    item.append(big, element("span", {}, words));
    return item;
  }));
}

const resistor = (ohm) => (ohm >= 1e6 ? `${+(ohm / 1e6).toPrecision(3)} MΩ` : `${+(ohm / 1e3).toPrecision(3)} kΩ`);

/** What drives the converter to its limit, and a resistor for this light. */
function whySaturated({ amplified, ambientA, element }) {
  const volts = (x) => `${+x.toPrecision(2)} V`, ohms = resistor(fittedOhm(amplified / element.ohm));
  return `: ${volts(amplified)} of ${volts(tables.stage.limitV)}, of which ${volts(ambientA * element.ohm)} from outside; ${ohms} would fit`;
}

/** Values with standard errors in one unit: its prefix, and the texts of both; those that are not known are none. */
function commonUnit(values, known) {
  const shown = values.filter(known), [factor, prefix] = prefixOf(Math.max(0, ...shown.map((one) => Math.abs(one.value))) || 1);
  return { prefix, cells: values.map((one, i) => (known(one, i) ? withError(one.value, one.error, "", factor).split(" ± ") : ["None", ""])) };
}

/** The selected reading and the force resolution on the scene's finger and on those of the people, side by side. */
function drawPeople() {
  const { result, layout } = workbench, fingers = [ownFinger, ...people], results = [result, ...result.people], row = result.rows[workbench.chosen.row], lines = [];
  const add = (name, values, unit, known) => { const { prefix, cells } = commonUnit(values, known); lines.push([cells.some(([, error]) => error) ? `${name} [${prefix}${unit}]` : name, cells]); };
  const resolutions = (of) => [of, ...of.people].map(resolutionOf), isResolved = (one, i) => isKnown(one.value, fingers[i]);
  add("Force resolution", resolutions(result), "N", isResolved);
  if (!isOwn()) add("… of the scene's own layout", resolutions(ownResult()), "N", isResolved);
  if (row && !row.few) {
    const theirs = results.map((of) => of.rows[workbench.chosen.row]);
    const isRead = (_, i) => !theirs[i].saturated;
    add(`${layout.leds[row.led].name} on ${row.element.name}, now`, theirs.map((one) => ({ value: one.volts, error: one.voltsError })), "V", isRead);
    add("… change by the touch", theirs.map((one) => ({ value: one.change, error: one.changeError })), "V", isRead);
  }
  lines.push(["Saturated readings", results.map((of) => [`${of.rows.filter((one) => one.saturated).length} of ${of.rows.length}`, ""])]);
  lines.push(["Blood at rest [%]", [layout.rest, ...people.map((person) => person.rest)].map((x) => [(100 * x).toFixed(1), ""])]);
  const head = element("tr", {}, ...["", "This finger", ...people.map((person) => `${100 * person.quantile} % quantile`)].map((text) => element("th", { scope: "col" }, text)));
  const body = lines.map(([name, cells]) => element("tr", {}, element("th", { scope: "row" }, name), ...cells.map(([number, small]) => {
    const cell = element("td", number === "None" || (name === "Saturated readings" && !number.startsWith("0")) ? { class: "bad" } : {}, number);
    if (small) cell.append(element("small", {}, `± ${small}`));
    return cell;
  })));
  $("people").replaceChildren(element("thead", {}, head), element("tbody", {}, ...body));
}

/** The causes of the selected reading's noise, the largest first, each as a bar as long as its part of the variance. */
function drawNoise() {
  const row = workbench.result.rows[workbench.chosen.row], host = $("noise");
  host.replaceChildren();
  if (!row || row.few) return;
  const budget = Object.entries(noiseBudget(row, workbench.layout)).sort((a, b) => b[1] - a[1]), total = budget.reduce((sum, [, v2]) => sum + v2, 0);
  const rms = (v2) => { const [factor, prefix] = prefixOf(Math.sqrt(v2)); return `${(Math.sqrt(v2) * factor).toPrecision(2)} ${prefix}V`; };
  for (const [cause, v2] of budget) {
    if (v2 < 1e-3 * total) continue;
    const bar = element("i", { style: `width: ${(100 * v2) / total}%` }), share = `${((100 * v2) / total).toFixed(v2 < 0.1 * total ? 1 : 0)} %`;
    host.append(element("li", {}, element("span", {}, cause), element("span", { class: "bar" }, bar), element("b", {}, rms(v2)), element("small", {}, share)));
  }
  $("noise-words").textContent = `${workbench.layout.leds[row.led].name} on ${row.element.name}: ${rms(total)} rms in one sample; percentages are of the variance${row.saturated ? ". The converter is at its limit, where noise says nothing" : ""}.`;
}

function drawReadings() {
  const { result, layout } = workbench;
  const head = ["Pair", "Distance [mm]", "Gain", "Detected at rest", "Now [V]", "Change [mV]", "Noise [mV]", "SNR of the change", "Shunted", "Ambient [V]", ""];
  const mark = (row, k) => (row.interpolated[k] ? " †" : ""), lines = result.rows.map((row) => {
    const led = layout.leds[row.led], separation = Math.hypot(led.u - row.element.u, led.v - row.element.v), noise = Math.sqrt(row.noiseV2);
    const scientific = (x) => x.toExponential(2).replace("e-", "·10⁻").replace(/⁻(\d+)/, (_, n) => `⁻${[...n].map((d) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[d]).join("")}`);
    const cells = row.few ? ["", "", "", "", "", "", "", "too few photons"] : [
      `${scientific(row.fractionRest)} ± ${((100 * row.restError) / row.fractionRest).toFixed(1)} %`, withError(row.volts, row.voltsError, "") + mark(row, 0), withError(row.change, row.changeError, "", 1e3) + mark(row, 1),
      (1e3 * noise).toPrecision(2), (Math.abs(row.change) / noise).toFixed(0), `${(100 * row.directShare).toFixed(0)} %`,
      row.ambientErrorA ? withError(row.ambientA, row.ambientErrorA, "", row.element.ohm) : "0", row.saturated ? "saturated" : ""];
    return [`${led.name} → ${row.element.name}`, separation.toFixed(2), resistor(row.element.ohm), ...cells];
  });
  const table = $("readings");
  if (table.rows.length !== lines.length + 1) table.replaceChildren(element("thead", {}, tableRow(head.map((text) => element("th", {}, text)))), element("tbody", {}, ...lines.map(emptyLine)));
  // A drag changes few of many lines, and what stays the same costs nothing.
  lines.forEach((cells, i) => {
    const line = table.rows[i + 1];
    cells.forEach((text, k) => { if (line.cells[k].textContent !== text) line.cells[k].textContent = text; });
    line.classList.toggle("chosen", i === workbench.chosen.row);
    line.lastChild.classList.toggle("bad", cells[cells.length - 1] !== "");
  });

  function tableRow(cells) { return element("tr", {}, ...cells); }

  function emptyLine(_, i) {
    const line = tableRow([element("th", { scope: "row" }), ...head.slice(1).map(() => element("td"))]);
    const choose = () => { workbench.chosen.row = i; workbench.chosen.part = workbench.result.rows[i].element.of.name; draw(); };
    line.tabIndex = 0;
    line.addEventListener("click", choose);
    line.addEventListener("keydown", (event) => { if (event.key === "Enter") choose(); });
    return line;
  }
}

// ---- the section: a reading's sensitivity to absorption, which goes as the fluence of the LED times that of a
// photodiode that shines

const CELL_PX = 3, DECADES = 3;
const SCALE_COLOURS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const SHADES = Array.from({ length: 256 }, (_, n) => {
  const t = (n / 255) * (SCALE_COLOURS.length - 1), k = Math.min(Math.floor(t), SCALE_COLOURS.length - 2);
  return `rgb(${SCALE_COLOURS[k].map((from, c) => from + (t - k) * (SCALE_COLOURS[k + 1][c] - from))})`;
});

function drawSection() {
  const canvas = $("section"), context = canvas.getContext("2d"), row = workbench.result.rows[workbench.chosen.row];
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * devicePixelRatio;
  canvas.height = height * devicePixelRatio;
  context.scale(devicePixelRatio, devicePixelRatio);
  if (!row) return;
  const led = workbench.layout.leds[row.led], separation = Math.hypot(led.u - row.element.u, led.v - row.element.v);
  const { epoxyMm, plateMm, bedMm } = tables.board, deep = tables.fluence.depthMm.at(-1), cell = workbench.dragging ? 2 * CELL_PX : CELL_PX;
  const sizes = [dieOf(led), row.element].map((one) => Math.min(one.width, one.length));
  const perMm = Math.min(height / (deep + epoxyMm + 0.6), width / (separation + Math.max(2, Math.max(...sizes) + 0.4)));
  // Names have room above the board.
  const top = epoxyMm + Math.max(0.6, 26 / perMm), x = (along) => width / 2 + (along - separation / 2) * perMm, y = (depth) => (depth + top) * perMm;
  const colour = colours[tables.ledKinds[led.kind].colour], cells = [];
  for (let px = 0; px < width; px += cell) {
    const along = separation / 2 + (px + cell / 2 - width / 2) / perMm;
    for (let py = y(0); py < y(deep); py += cell) {
      const depth = (py + cell / 2) / perMm - top;
      cells.push([px, py, depth, logFluence(colour, Math.abs(along), depth) + logFluence(colour, Math.abs(along - separation), depth)]);
    }
  }
  const most = Math.max(...cells.map(([, , depth, value]) => (depth > plateMm ? value : -Infinity)));
  for (const [px, py, , value] of cells) {
    context.fillStyle = SHADES[Math.round(255 * Math.min(1, Math.max(0, 1 + (value - most) / (DECADES * Math.LN10))))];
    // A pixel more leaves no seams.
    context.fillRect(px, py, cell + 1, cell + 1);
  }
  context.font = "14px system-ui, sans-serif";
  const style = getComputedStyle(document.documentElement);
  const drawPart = (name, along, size, variable) => {
    context.fillStyle = style.getPropertyValue(variable);
    context.fillRect(x(along - size / 2), y(-epoxyMm) - 6, size * perMm, 8);
    context.fillText(name, x(along), y(-epoxyMm) - 11);
  };
  context.textAlign = "center";
  drawPart(led.name, 0, sizes[0], "--led");
  drawPart(row.element.name, separation, sizes[1], "--diode");
  const line = (fromX, fromY, length, text) => {
    context.fillRect(fromX, fromY, length, 1.5);
    context.fillText(text, fromX + 6, fromY - 5);
  };
  context.textAlign = "left";
  context.shadowColor = "#000";
  context.shadowBlur = 3;
  context.fillStyle = "#fff";
  line(0, y(plateMm), width, "plate");
  line(0, y(plateMm + bedMm), width, "bed");
  line(width - Math.max(perMm, 44) - 12, y(deep) - 8, perMm, "1 mm");
  $("section-words").textContent = `Section through ${led.name} and ${row.element.name}, ${separation.toFixed(2)} mm apart: sensitivity of this reading to absorption, relative to the highest below the plate. It is the product of the fluence of both, as in the middle of a board without a wall.`;
}

// ---- over force

const plots = {};

function plotOptions(series, logarithmic, label) {
  const style = getComputedStyle(document.documentElement), ink = style.getPropertyValue("--ink"), grid = style.getPropertyValue("--grid");
  const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid }, font: "12px system-ui, sans-serif" };
  return {
    width: 440, height: 260, legend: { show: series.length > 2 && !series.some((one) => one.hidden) }, cursor: { drag: { x: false, y: false } },
    scales: { x: { time: false }, y: logarithmic ? { distr: 3 } : {} },
    axes: [{ ...axis, label: "Force [N]" }, { ...axis, label, size: 62 }],
    series: [{ label: "Force [N]" }, ...series],
    hooks: { draw: [(u) => {
      const at = u.valToPos(workbench.layout.force, "x", true);
      u.ctx.save();
      u.ctx.strokeStyle = style.getPropertyValue("--muted");
      u.ctx.setLineDash([4, 4]);
      u.ctx.beginPath();
      u.ctx.moveTo(at, u.bbox.top);
      u.ctx.lineTo(at, u.bbox.top + u.bbox.height);
      u.ctx.stroke();
      u.ctx.restore();
    }] },
  };
}

function setPlot(id, data, series, logarithmic, label, bands) {
  const host = $(id);
  if (!plots[id]) {
    const options = plotOptions(series, logarithmic, label);
    if (bands) options.bands = bands;
    options.width = Math.max(260, host.clientWidth);
    plots[id] = new uPlot(options, data, host);
    new ResizeObserver(() => plots[id].setSize({ width: Math.max(260, host.clientWidth), height: 260 })).observe(host);
  } else plots[id].setData(data);
}

function drawPlots() {
  const { layout, result } = workbench, forces = tables.touch.force_n, row = result.rows[workbench.chosen.row];
  const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue(name).trim();
  if (row) {
    const rest = stateAt(0, layout.rest, layout.so2), counted = row.changeCounted / Math.max(row.gross, 1e-30);
    const values = [], errors = [];
    for (const force of forces) {
      const state = stateAt(force, layout.rest, layout.so2);
      values.push(1e3 * row.gain * (dot(monomials(state), row.pair.coefficients) - row.fractionRest));
      // All forces share the same photons: their part of the error scales with the change of either zone.
      const gross = [0, 1].reduce((sum, k) => sum + Math.abs((state[k] - rest[k]) * row.slope[k]), 0);
      errors.push(2e3 * row.gain * gross * Math.hypot(counted, tables.kernelChangeError));
    }
    $("change-title").textContent = `Change of ${layout.leds[row.led].name} on ${row.element.name}`;
    setPlot("change-plot", [forces, values, values.map((x, k) => x - errors[k]), values.map((x, k) => x + errors[k])], [
      { label: "change", stroke: read("--chosen"), width: 2, hidden: true, points: { show: false } },
      { label: "low", stroke: "transparent", hidden: true, points: { show: false } }, { label: "high", stroke: "transparent", hidden: true, points: { show: false } },
    ], false, "Change [mV]", [{ series: [3, 2], fill: `${read("--chosen")}33` }]);
  }
  const rows = result.rows.filter((one) => !one.few), resolutions = { body: [], electronics: [] };
  for (const force of forces) {
    const state = stateAt(force, layout.rest, layout.so2), slopes = [monomials(state, 0), monomials(state, 1)], now = monomials(state);
    const there = rows.map((one) => {
      const light = Math.max(dot(now, one.pair.coefficients), 0) * one.gain;
      const read = stage(tables.photodiodeKinds[one.element.kind], light / one.element.ohm, one.ambientA, one.element.ohm);
      return { led: one.led, light, zone: slopes.map((slope) => dot(slope, one.pair.coefficients) * one.gain), ...read };
    });
    const scaled = atForce(tables.touch.blood_per_pa, force).map((x) => x.map((y) => y * layout.rest));
    const waves = atForce(tables.touch.waves, force).map((x) => x.map((y) => y * layout.rest ** 2));
    for (const [name, body] of [["body", tables.touch.has_body], ["electronics", false]]) {
      const value = forceResolution(there, { bloodPerPa: scaled, waves, body, force }, layout.leds.length);
      resolutions[name].push(isKnown(value, ownFinger, force) ? 1e3 * value : null);
    }
  }
  const lines = [{ label: "electronics alone", stroke: read("--diode"), width: 2, dash: tables.touch.has_body ? [6, 4] : [], points: { show: false } }], data = [forces, resolutions.electronics];
  if (tables.touch.has_body) { lines.unshift({ label: "with physiological noise", stroke: read("--led"), width: 2, points: { show: false } }); data.splice(1, 0, resolutions.body); }
  setPlot("resolution-plot", data, lines, true, "Resolution [mN]");
}

// ---- controls

function drawProperties() {
  const host = $("properties"), selected = chosenPart();
  if (host.contains(document.activeElement) && document.activeElement.matches("input, select") && host.dataset.name === (selected ? selected[1].name : "")) {
    for (const input of host.querySelectorAll("input[data-key]")) if (input !== document.activeElement) input.value = +selected[1][input.dataset.key].toFixed(4);
    return;
  }
  host.replaceChildren();
  host.dataset.name = selected ? selected[1].name : "";
  if (!selected) { host.append(element("span", { class: "small" }, "Select a part to edit it.")); return; }
  const [kind, part] = selected, edit = (key, value) => change((layout) => {
    const target = [...layout.leds, ...layout.photodiodes].find((one) => one.name === part.name);
    if (["u", "v", "turn"].includes(key)) movePart(layout, part.name, { ...target, [key]: value });
    else target[key] = value;
    if (key === "elements") target.wired = null;
  });
  const number = (key, text, step, unit) => {
    const input = element("input", { type: "number", step, "data-key": key, value: +(+part[key]).toFixed(4), "aria-label": text });
    input.addEventListener("change", () => { const x = Number(input.value); if (input.value !== "") edit(key, x); input.value = +(+chosenPart()[1][key]).toFixed(4); });
    const label = element("label", {}, text);
    label.append(input, unit);
    return label;
  };
  host.append(element("strong", {}, `${kind === "led" ? "LED" : "Photodiode"} ${part.name}`));
  const kinds = kind === "led" ? tables.ledKinds : tables.photodiodeKinds;
  const select = element("select", { id: "kind", "aria-label": kind === "led" ? "Wavelength" : "Part" });
  kinds.forEach((one, i) => select.append(element("option", i === part.kind ? { value: i, selected: "" } : { value: i }, one.title)));
  select.addEventListener("change", () => edit("kind", Number(select.value)));
  host.append(select, number("u", "u", 0.05, "mm"), number("v", "v", 0.05, "mm"), number("turn", "turn", 15, "°"));
  if (kind === "diode") host.append(number("width", "width", 0.05, "mm"), number("length", "length", 0.05, "mm"), number("elements", "elements", 1, ""));
  const button = (id, text, title, act) => {
    const made = element("button", { type: "button", id, title }, text);
    made.addEventListener("click", act);
    host.append(made);
  };
  for (const axis of ["u", "v"]) {
    button(`align-${axis}`, `Align ${axis}`, `To the nearest ${axis} of another part`, () => align(part, axis));
    button(`mirror-${axis}`, `Mirror ${axis}`, `To the other side of the nail's centre line, ${axis} to −${axis}`, () => change((layout) => {
      if (moduleOf(part)) movePart(layout, part.name, mirrored(part, axis));
      else for (const list of [layout.leds, layout.photodiodes]) list.forEach((one, i) => { if (one.name === part.name) list[i] = mirrored(one, axis); });
    }));
  }
  button("remove", "Remove", "Delete", removeChosen);
}

/** Move a part to the nearest coordinate of another that it does not have yet. */
function align(part, axis) {
  const others = allParts().map(([, one]) => one[axis]).filter((x) => Math.abs(x - part[axis]) > 1e-6);
  if (!others.length) { say(`No other part has another ${axis}.`); return; }
  const nearest = others.reduce((a, b) => (Math.abs(b - part[axis]) < Math.abs(a - part[axis]) ? b : a));
  change((layout) => movePart(layout, part.name, { ...part, [axis]: nearest }));
}

function removeChosen() {
  const selected = chosenPart();
  if (!selected) return;
  change((layout) => {
    layout.leds = layout.leds.filter((part) => !isWith(part, selected[1]));
    layout.photodiodes = layout.photodiodes.filter((part) => !isWith(part, selected[1]));
  });
}

/** The next reference like one of the board's file that neither a part here nor an ignored one has. */
function freeReference(like) {
  const taken = new Set([...allParts().map(([, part]) => part.reference), ...(tables.scene.board.unmapped || [])]), stem = like.replace(/[0-9]+$/, "");
  let n = 1;
  while (taken.has(`${stem}${n}`)) n += 1;
  return `${stem}${n}`;
}

function addPart(kind) {
  change((layout) => {
    const list = kind === "led" ? layout.leds : layout.photodiodes, like = list[list.length - 1], names = new Set(allParts().map(([, part]) => part.name));
    let n = 1;
    const stem = kind === "led" ? "led" : "pd";
    while (names.has(`${stem}${n}`)) n += 1;
    const usual = kind === "led" ? { kind: 0, turn: 0 } : { kind: 0, turn: 0, width: 1, length: 1, elements: 1, pitch: null, wired: null };
    const made = { ...usual, ...(like ? copy(like) : { u: 0, v: 0 }), name: `${stem}${n}` };
    made.reference = like && like.reference ? freeReference(moduleOf(like) ? { led: "D", diode: "PD" }[kind] : like.reference) : null;
    if (kind === "diode") { made.elements = 1; made.wired = null; made.pitch = null; }
    const [uMin, uMax, vMin, vMax] = tables.board.outline, tried = [];
    // The free place that is nearest to the part that it is like.
    for (let u = uMin + 0.6; u < uMax - 0.5; u += 0.25) for (let v = vMin + 0.6; v < vMax - 0.5; v += 0.25) tried.push([Math.hypot(u - made.u, v - made.v), u, v]);
    tried.sort((a, b) => a[0] - b[0]);
    const free = tried.find(([, u, v]) => { made.u = +u.toFixed(3); made.v = +v.toFixed(3); return !problems({ ...layout, [kind === "led" ? "leds" : "photodiodes"]: [...list, made] }).some((text) => text.includes(made.name) || text.includes("wall")); });
    list.push(made);
    workbench.chosen.part = made.name;
    if (!free) say("There is no free position left for it.");
  });
}

function slider(id, range, factor, step, read, write) {
  const bar = $(id), number = $(`${id}-number`);
  for (const input of [bar, number]) { input.min = (range[0] * factor).toFixed(4); input.max = (range[1] * factor).toFixed(4); }
  bar.step = step;
  let before = null;
  const set = (layout, value) => { layout[write] = Math.min(range[1], Math.max(range[0], value / factor)); };
  bar.addEventListener("input", () => { before = before || copy(workbench.layout); set(workbench.layout, Number(bar.value)); draw(); });
  bar.addEventListener("change", () => { if (before) remember(before); before = null; draw(); });
  number.addEventListener("change", () => { if (number.value !== "" && Number.isFinite(Number(number.value))) change((layout) => set(layout, Number(number.value))); else draw(); });
  return () => {
    const value = read() * factor;
    if (document.activeElement !== bar) bar.value = value;
    if (document.activeElement !== number || Number(number.value) !== value) number.value = +value.toFixed(3);
  };
}

const sliders = [];

function listen() {
  const reach = tables.touch.force_n[tables.touch.force_n.length - 1];
  sliders.push(slider("force", [0, reach], 1, 0.01, () => workbench.layout.force, "force"));
  sliders.push(slider("rest", tables.restRange, 100, 0.01, () => workbench.layout.rest, "rest"));
  sliders.push(slider("so2", tables.polynomial.so2, 100, 0.1, () => workbench.layout.so2, "so2"));
  if (tables.restRange[0] === tables.restRange[1]) $("rest").closest("label").hidden = true;
  $("ambient").append(element("option", { value: "" }, "none"), ...tables.ambient.names.map((name, i) => element("option", { value: i }, `${name}${tables.board.covered ? ", through the finger" : ""}`)));
  $("ambient").addEventListener("change", () => change((layout) => { layout.ambient = $("ambient").value === "" ? null : Number($("ambient").value); }));
  $("undo").addEventListener("click", () => step(workbench.past, workbench.future));
  $("redo").addEventListener("click", () => step(workbench.future, workbench.past));
  $("reset").addEventListener("click", () => change((layout) => Object.assign(layout, copy(tables.layout))));
  $("other").addEventListener("click", showOther);
  $("add-led").addEventListener("click", () => addPart("led"));
  $("add-photodiode").addEventListener("click", () => addPart("diode"));
  $("save-scene").addEventListener("click", () => save("explored.toml", smolToml.stringify(toScene(workbench.layout)), "application/toml"));
  $("save-positions").addEventListener("click", () => save("explored.csv", toPositions(workbench.layout), "text/csv"));
  $("copy-link").addEventListener("click", () => {
    const done = () => say("The link is on the clipboard."), shown = () => say(location.href);
    if (navigator.clipboard) navigator.clipboard.writeText(location.href).then(done, shown); else shown();
  });
  $("open").addEventListener("change", () => { if ($("open").files[0]) openFile($("open").files[0]); });
  document.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
  document.addEventListener("dragleave", () => document.body.classList.remove("dropping"));
  document.addEventListener("drop", (event) => { event.preventDefault(); document.body.classList.remove("dropping"); if (event.dataTransfer.files[0]) openFile(event.dataTransfer.files[0]); });
  window.addEventListener("hashchange", () => { try { const linked = fromLink(location.hash.slice(1)); change((layout) => Object.assign(layout, linked)); } catch (error) { say(`That link is of another page: ${error.message}.`); } });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const id of Object.keys(plots)) { plots[id].destroy(); delete plots[id]; } draw(); });
  listenToKeys();
  listenToDrags();
}

function listenToKeys() {
  document.addEventListener("keydown", (event) => {
    if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && !event.target.matches("input")) {
      event.preventDefault();
      if (event.shiftKey) step(workbench.future, workbench.past); else step(workbench.past, workbench.future);
    }
  });
  $("board").addEventListener("focusin", (event) => { const part = event.target.closest(".part"); if (part && workbench.chosen.part !== part.dataset.name) choosePart(part.dataset.name); });
  $("board").addEventListener("keydown", (event) => {
    const selected = chosenPart(), far = event.shiftKey ? 0.5 : Math.max(0.05, snapMm());
    const moves = { ArrowLeft: [-far, 0], ArrowRight: [far, 0], ArrowUp: [0, far], ArrowDown: [0, -far] };
    if (!selected) return;
    const { name, u, v, turn } = selected[1], [x, y] = moves[event.key] || [];
    if (moves[event.key]) change((layout) => movePart(layout, name, { u: u + x, v: v + y, turn }));
    else if (event.key.toLowerCase() === "r") change((layout) => movePart(layout, name, { u, v, turn: moduleOf(selected[1]) ? turn + 15 : (turn + 15) % 180 }));
    else if (event.key === "Delete" || event.key === "Backspace") removeChosen();
    else return;
    event.preventDefault();
  });
}

function choosePart(name) {
  workbench.chosen.part = name;
  const rows = workbench.result.rows, row = rows[workbench.chosen.row], led = workbench.layout.leds.findIndex((part) => part.name === name);
  const own = (one) => (led >= 0 ? one.led === led : one.element.of.name === name);
  if (!row || !own(row)) {
    const same = rows.findIndex((one) => own(one) && (led >= 0 ? row && one.element.name === row.element.name : row && one.led === row.led));
    workbench.chosen.row = Math.max(0, same >= 0 ? same : rows.findIndex(own));
  }
  draw();
}

const snapMm = () => Number($("snap").value);

function listenToDrags() {
  let before = null, at = null, waiting = false;
  const perPixel = () => { const matrix = $("board").getScreenCTM(); return 1 / matrix.a; };
  interact("#board .part").draggable({
    listeners: {
      start(event) { before = copy(workbench.layout); choosePart(event.target.dataset.name); const part = chosenPart()[1]; at = [part.u, part.v]; },
      move(event) {
        at = [at[0] + event.dx * perPixel(), at[1] - event.dy * perPixel()];
        const part = chosenPart()[1], [uMin, uMax, vMin, vMax] = tables.board.outline;
        const snapped = (x) => +(Math.round(x / snapMm()) * snapMm()).toFixed(2);
        movePart(workbench.layout, part.name, { ...part, u: snapped(Math.min(uMax, Math.max(uMin, at[0]))), v: snapped(Math.min(vMax, Math.max(vMin, at[1]))) });
        workbench.dragging = true;
        if (!waiting) { waiting = true; requestAnimationFrame(() => { waiting = false; draw(); }); }
      },
      end() { workbench.dragging = false; remember(before); draw(); },
    },
  }).styleCursor(false);
  // Chromium heeds touch-action of a whole drawing alone; this leaves the page to be scrolled beside the parts.
  $("board").addEventListener("touchstart", (event) => { if (event.target.closest(".part")) event.preventDefault(); }, { passive: false });
  interact("#board .part").on("tap", (event) => choosePart(event.currentTarget.dataset.name));
}

function save(name, text, type) {
  const link = element("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  say(`${name} is saved.`);
}

async function openFile(file) {
  try {
    if (file.size > tables.rules.mostBytes) throw new Error(`has ${(file.size / 1e6).toFixed(1)} MB, more than ${tables.rules.mostBytes / 1e6}; a scene has less.`);
    const opened = fromScene(smolToml.parse(await file.text()), workbench.layout);
    change((layout) => Object.assign(layout, opened));
    say(`${file.name}: its parts lie on this page's board; finger, vessels and board stay as they are here.`);
  } catch (error) { say(`${file.name}: ${error.message}`); }
}

/** That the page's board is another than the scene's: light from outside goes by its edges. */
function otherBoard() {
  const { outline, ownMm } = tables.board, here = [outline[1] - outline[0], outline[3] - outline[2]], size = (mm) => mm.map((x) => x.toPrecision(3)).join(" by ");
  if (here.every((x, k) => Math.abs(x - ownMm[k]) < 0.01)) return "";
  return `This page's board is ${size(here)} mm; the scene's, as simulate takes it, is ${size(ownMm)} mm: its own layout gets other light from outside there, and may be saturated where it is not here. Give board.size_mm for one board in both.`;
}

/** That readings rest on too few photons for their standard errors: on the prototype 100 000 made the eight readings 6 % too low in the mean of three seeds, one of them 17 %; 300 000 made them 4 % too low, a million not, and on an open board 400 000. */
function fewPhotons() {
  const least = basis.walled ? 1e6 : 4e5, { photons } = tables.colours[0];
  return photons < least ? `${photons} photons of each wavelength of the scene are too few: smoothing makes readings up to 20 % too low, beyond their standard errors. Give --photons ${least} or more.` : "";
}

function drawFixed() {
  const { board } = tables, ohm = tables.stage.feedbackOhm, darkV2 = tables.photodiodeKinds.map((kind) => stage(kind, 0, 0, ohm ?? 0).noiseV2);
  // With fitted resistors it goes with the light.
  const dark = ohm === null ? "" : `, ${(1e3 * Math.sqrt(Math.min(...darkV2))).toPrecision(2)} mV in the dark`, lines = [
    `The board's outline, ${(board.outline[1] - board.outline[0]).toFixed(1)} by ${(board.outline[3] - board.outline[2]).toFixed(1)} mm, its ${board.covered ? "cover" : "film without a cover"}, epoxy and the finger are fixed.`,
    board.wall ? `The wall stays at its place: LEDs can be moved ${{ left: "left of", right: "right of", below: "below", above: "above" }[board.wall.side]} it, photodiodes on its other side.` : "The board has no wall.",
    "Blood is that of a held touch, in steady state; simulate computes its dynamics.",
    tables.touch.has_body ? "Force resolution includes the scene's physiological noise, as in place, and is given for the electronics alone, too." : "The scene has no body: force resolution is limited by the noise of the electronics alone.",
    `The noise of one sample is that of amplifier and converter${dark}, and the shot noise of its light, ambient light included.`,
    `Beside photon noise, readings have an rms error of ${(100 * tables.kernelError).toFixed(1)} %, changes of ${(100 * tables.kernelChangeError).toFixed(1)} % of the sum of both zones' absolute contributions, and the force resolution of ${(100 * tables.kernelResolutionError).toFixed(1)} %, by interpolation between the table's nodes and the few percent of light that photodiodes absorb and a bare board reflects. The stated errors include this.`,
    "Parts are taken to be flush with the board's underside. Ambient light is computed with the scene's own photodiode and cover.",
  ];
  const { count, forceN } = tables.peopleDrawn, ranked = commonUnit(people.map((person) => ({ value: person.resolutionN, error: 0 })), (one, i) => isKnown(one.value, people[i], forceN));
  ranked.cells = ranked.cells.map(([number]) => [number === "None" ? "none" : String(+Number(number).toPrecision(2))]);
  $("people-words").textContent = `10, 50 and 90 % of ${count} people drawn from the priors resolve a force of ${forceN} N as finely as these or finer with the scene's own layout and a resistor that fits each reading${ranked.cells.some(([number]) => number !== "none") ? `: ${ranked.cells.map(([number]) => number).join(", ")} ${ranked.prefix}N` : ""}.${ranked.cells.some(([number]) => number === "none") ? " None: readings do not resolve this force, as where it has closed the vessels." : ""} They differ in what absorbs, in blood, vessels, touch${tables.touch.has_body ? " and waves" : ""}; scattering, thicknesses and sizes stay this finger's, as do the board's resistors and the light from outside. All are read by the same photons and tables: the errors are mostly common to them. On the prototype nine tenths of the photons' part cancel in the ratio of two people's readings, and two thirds in that of their changes.`;
  $("error-words").textContent = `± is one standard error, of photon noise and of interpolation between the table's nodes; † where interpolation has the larger part, which more photons do not reduce: ${(100 * tables.kernelError).toFixed(0)} % of a reading, and ${(100 * tables.kernelChangeError).toFixed(0)} % of what the blood of both zones changes it by. Select a row to see its pair above and its section.`;
  $("gain-words").textContent = tables.stage.feedbackOhm === null ? `Each photodiode's resistor is fitted to the LEDs and to the ambient light chosen here (${tables.ambient.names[tables.ambient.usual]} where there is none); Gain in the table of readings has it.` : "Resistors are the scene's, whatever the ambient light.";
  if (otherBoard()) $("gain-words").textContent += ` Ambient light is that of this page's board, not of the scene's (${tables.board.ownMm.map((x) => x.toPrecision(3)).join(" by ")} mm).`;
  $("board-words").textContent = [otherBoard(), fewPhotons()].filter(Boolean).join(" ");
  $("board-words").hidden = !$("board-words").textContent;
  $("fixed").replaceChildren(...lines.map((text) => element("li", {}, text)));
}

function draw() {
  const begin = performance.now(), violations = problems(workbench.layout);
  workbench.result = evaluate(workbench.layout, caches);
  workbench.chosen.row = Math.min(workbench.chosen.row, Math.max(0, workbench.result.rows.length - 1));
  $("problem").hidden = !violations.length;
  $("problem").textContent = violations.length ? `This cannot be built: ${violations.slice(0, 3).join("; ")}.` : "";
  $("workbench").classList.toggle("broken", violations.length > 0);
  for (const id of ["save-scene", "save-positions"]) $(id).disabled = violations.length > 0;
  $("undo").disabled = !workbench.past.length;
  $("redo").disabled = !workbench.future.length;
  for (const update of sliders) update();
  $("other").disabled = isOwn() && !workbench.other;
  $("other").textContent = workbench.other ? "A/B: back to yours" : "A/B: the scene's own";
  $("ambient").value = workbench.layout.ambient === null ? "" : workbench.layout.ambient;
  drawBoard();
  drawCards();
  drawPeople();
  drawProperties();
  drawReadings();
  drawSection();
  drawNoise();
  drawPlots();
  workbench.milliseconds = performance.now() - begin;
}

tables.layout = ownLayoutOf(tables.scene);
workbench.layout = copy(tables.layout);
if (location.hash.length > 1) { try { workbench.layout = fromLink(location.hash.slice(1)); } catch (error) { say(`The link is of another page, and the scene's own layout is shown: ${error.message}.`); } }
$("section-colours").style.background = `linear-gradient(to right, ${SCALE_COLOURS.map((rgb) => `rgb(${rgb})`)})`;
addEventListener("resize", drawSection);
listen();
drawFixed();
draw();
