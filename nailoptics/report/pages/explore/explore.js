// The page of `nailoptics explore`: any layout from tables that Python traced, at once.
// Two parts: the light between two places and the force resolution (physics), the layout (state). The page follows.
"use strict";

const tables = JSON.parse(document.getElementById("tables").textContent);
{
  const { finger, board, blood } = tables.scene;
  Object.assign(tables.board, {
    center: board.center_mm, nailMm: [finger.nail_width_mm, finger.nail_length_mm], plateMm: finger.nail_thickness_mm, bedMm: finger.bed_thickness_mm,
    covered: board.cover_um > 0,
  });
  // Blood at rest, from the least to the most that can be chosen: none, where what is venous depends on it.
  tables.restRange = tables.bloodRange.map((factor) => blood.rest_blood_fraction * (blood.venous_so2 === undefined ? factor : 1));
  // The force resolved goes as the slopes of the readings.
  tables.kernelResolutionError = Math.hypot(tables.kernelError, tables.kernelChangeError);
}

// ---------------------------------------------------------------------------------------------------- physics

/** Every number of half precision, by its 16 bits. */
const halves = new Float32Array(1 << 16);
for (let word = 0; word < halves.length; word++) {
  const exponent = (word >> 10) & 31, fraction = word & 1023, sign = word >> 15 ? -1 : 1;
  halves[word] = exponent ? sign * 2 ** (exponent - 15) * (1 + fraction / 1024) : sign * 2 ** -24 * fraction;
}

/** Half-precision numbers in base64, as Python packed them: the less significant byte first. */
function unpackHalf(text) {
  const bytes = atob(text), numbers = new Float32Array(bytes.length / 2);
  for (let i = 0; i < numbers.length; i++) {
    numbers[i] = halves[bytes.charCodeAt(2 * i) | (bytes.charCodeAt(2 * i + 1) << 8)];
  }
  return numbers;
}

const colours = tables.colours.map((colour) => ({
  ...colour, coefficients: unpackHalf(colour.coefficients), direct: unpackHalf(colour.direct), blocks: unpackHalf(colour.blocks),
  logFluence: unpackHalf(colour.logFluence), people: unpackHalf(colour.people),
}));
const basis = tables.basis;
const monomialCount = tables.polynomial.exponents.length;
const blockCount = tables.blocks;
// Fingers on which a layout is read: the scene's own, then those of people drawn from the priors.
const ownFinger = { touch: tables.touch, polynomial: tables.polynomial }, { people } = tables;
const personCount = people.length, personMonomials = people[0].polynomial.exponents.length;
const size = basis.axes.reduce((n, axis) => n * axis.length, 1);

/** Index of the node before x and the part of the way to the next; what lies outside counts as on the edge. */
function lineNode(axis, x) {
  let low = 0, high = axis.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (axis[middle] <= x) low = middle; else high = middle;
  }
  return [low, Math.min(1, Math.max(0, (x - axis[low]) / (axis[low + 1] - axis[low])))];
}

/** Add the table's functions at a pair of places, times a weight, to sums. */
function addFunctions(x, y, weight, sums) {
  const a = basis.across, b = 1 - a, nodes = [], half = (k) => [Math.abs(x[k] - y[k]), (x[k] + y[k]) / 2];
  const point = [...(basis.walled ? [x[a], y[a]] : half(a)), ...half(b)];
  for (let k = 0; k < 4; k++) nodes.push(lineNode(basis.axes[k], point[k]));
  for (let corner = 0; corner < 16; corner++) {
    let index = 0, product = weight;
    for (let k = 0; k < 4; k++) {
      const up = (corner >> k) & 1;
      index = index * basis.axes[k].length + nodes[k][0] + up;
      product *= up ? nodes[k][1] : 1 - nodes[k][1];
    }
    if (product !== 0) sums[index] += product;
  }
}

/** g: how light falls with the distance between two places. [mm] */
function radial(distance) {
  const at = Math.log(Math.max(distance, basis.nearestMm));
  return Math.exp(basis.radial.reduce((sum, c) => sum * at + c, 0));
}

/** Gauss points of a turned rectangle: [u, v, part of its area]. */
function points(rectangle, spacingMm) {
  const { u, v, width, length, turn } = rectangle, cos = Math.cos(turn), sin = Math.sin(turn), nodes = [];
  const rule = (extent) => tables.gauss[Math.min(tables.gauss.length - 1, Math.max(1, Math.ceil(extent / spacingMm)))];
  for (const [a, wa] of rule(width)) {
    for (const [b, wb] of rule(length)) {
      const x = (a * width) / 2, y = (b * length) / 2;
      nodes.push([u + cos * x - sin * y, v + sin * x + cos * y, (wa * wb) / 4]);
    }
  }
  return nodes;
}

/**
 * What a photodiode's element reads of an LED: coefficients over blood and saturation, those of each person, its direct
 * part, and without each group of photons, as parts of the whole, the reading and its change with the blood of either
 * zone at rest. Parts of the LED's light.
 */
function readPair(led, element, colour) {
  const sums = new Float64Array(size), area = element.width * element.length, onElement = points(element, 0.25);
  for (const x of points(led, 0.25)) for (const y of onElement) addFunctions(x, y, x[2] * y[2] * area * radial(Math.hypot(x[0] - y[0], x[1] - y[1])), sums);
  const coefficients = new Float64Array(monomialCount), blocks = new Float64Array(3 * blockCount);
  const ofPeople = people.map(() => new Float64Array(personMonomials));
  let direct = 0;
  for (let k = 0; k < size; k++) {
    if (sums[k] === 0) continue;
    for (let m = 0; m < monomialCount; m++) coefficients[m] += sums[k] * colour.coefficients[k * monomialCount + m];
    for (let m = 0; m < blocks.length; m++) blocks[m] += sums[k] * colour.blocks[k * blocks.length + m];
    for (let i = 0; i < personCount; i++) for (let m = 0; m < personMonomials; m++) ofPeople[i][m] += sums[k] * colour.people[(i * size + k) * personMonomials + m];
    direct += sums[k] * colour.direct[k];
  }
  const without = [0, 1, 2].map((q) => {
    const values = Array.from({ length: blockCount }, (_, k) => blocks[3 * k + q]), mean = values.reduce((sum, x) => sum + x, 0) / blockCount;
    return values.map((x) => (mean ? (blockCount * mean - x) / (blockCount - 1) / mean : 1));
  });
  return { coefficients, without, direct, people: ofPeople };
}

/** Logarithm of the fluence rate around a source, at a distance and a depth. [mm] */
function logFluence(colour, distance, depth) {
  const { radiusMm, depthMm } = tables.fluence, [i, a] = lineNode(radiusMm, distance), [j, b] = lineNode(depthMm, depth);
  const at = (ring, k = ring * depthMm.length + j) => (1 - b) * colour.logFluence[k] + b * colour.logFluence[k + 1];
  return (1 - a) * at(i) + a * at(i + 1);
}

/** Each monomial at a state [blood, blood, saturation], or its derivative by the blood of a zone. */
function monomials(state, zone = null, polynomial = tables.polynomial) {
  const { exponents, bloodFraction, so2 } = polynomial, bounds = [bloodFraction, bloodFraction, so2];
  const scaled = state.map((x, k) => (2 * (x - bounds[k][0])) / (bounds[k][1] - bounds[k][0]) - 1);
  return exponents.map((powers) => powers.reduce((product, power, k) => {
    // A person has one saturation alone, whose power is none.
    if (power === 0 && k !== zone) return product;
    if (k !== zone) return product * scaled[k] ** power;
    return power ? (product * power * scaled[k] ** (power - 1) * 2) / (bounds[k][1] - bounds[k][0]) : 0;
  }, 1));
}

const dot = (one, other) => one.reduce((sum, x, k) => sum + x * other[k], 0);

/** Rows of a table over force at one force, linear between: any shape of numbers below the first axis. */
function atForce(rows, force) {
  const [i, part] = lineNode(tables.touch.force_n, force);
  const mix = (one, other) => (Array.isArray(one) ? one.map((x, k) => mix(x, other[k])) : one + part * (other - one));
  return mix(rows[i], rows[i + 1]);
}

/** Blood of both zones and its saturation under a held force. */
function stateAt(force, rest, so2, { touch, polynomial } = ownFinger) {
  const [low, high] = polynomial.bloodFraction;
  return [...atForce(touch.blood, force).map((x) => Math.min(high, Math.max(low, x * rest))), so2];
}

/** What a finger's readings take from its blood at rest and under a held force. */
function touched(finger, force, rest, so2) {
  const { polynomial } = finger, [start, state] = [0, force].map((at) => stateAt(at, rest, so2, finger));
  const slopes = (at) => [0, 1].map((zone) => monomials(at, zone, polynomial));
  return {
    start, state, rest: monomials(start, null, polynomial), now: monomials(state, null, polynomial), slope: slopes(state), restSlope: slopes(start),
    moved: [0, 1].map((k) => state[k] - start[k]),
  };
}

/** The largest E24 resistor that holds a photocurrent [A] below the converter's limit by the headroom. [ohm] */
function fittedOhm(largestA) {
  const { headroom, mostOhm, e24, limitV } = tables.stage, most = Math.min(mostOhm, limitV / headroom / largestA) * (1 + 1e-9);
  const step = 10 ** (Math.floor(Math.log10(most)) - 1);
  return e24.findLast((x) => x <= Math.max(most / step, 10)) * step;
}

/** Noise variance of one reading, by its causes and their sum [V^2], at the photocurrents of LED and ambient light [A] and a feedback resistance, its mean, the stage's output [V] and whether the converter is at its limit. */
function stage(kind, lit, ambient, ohm) {
  const { rangeV, limitV, rejects } = tables.stage, amplified = (lit + ambient + kind.darkA) * ohm, one = kind.noise, ohm2 = ohm * ohm;
  // What the converter cuts off adds no noise.
  const read = Math.max(Math.min(lit, lit + (limitV - amplified) / ohm), 0);
  const noise = {
    "shot noise": ohm2 * (one.darkPerOhm2 + one.shotPerOhm2A * read),
    // What rejection subtracts has the noise of ambient light, too.
    "ambient light": ohm2 * one.shotPerOhm2A * (rejects ? 2 : 1) * ambient,
    "feedback resistor": ohm * one.feedbackPerOhm,
    "shunt resistance": ohm2 * one.shuntPerOhm2,
    amplifier: one.amplifierV2 + ohm2 * one.amplifierPerOhm2,
    converter: one.converterV2,
  };
  return {
    volts: Math.min(amplified, rangeV) - (rejects ? Math.min((ambient + kind.darkA) * ohm, rangeV) : 0),
    amplified,
    noise,
    noiseV2: Object.values(noise).reduce((sum, x) => sum + x, 0),
    saturated: amplified >= limitV,
  };
}

/**
 * The force that one sample of all readings resolves, whatever its split. [N]
 * readings : [{led, light, zone: [V, V], noiseV2, saturated}], light and zone in volts.
 * point : blood per Pa (zone, pressure), waves' covariance of the blood; null where the body is left out; the finger's touch.
 */
function forceResolution(readings, point, ledCount) {
  const { body, force, touch = tables.touch } = point, extra = body ? 2 + ledCount + 1 : 0, n = 2 + extra;
  const total = Array.from({ length: n }, () => new Float64Array(n)), waves = body ? root2(point.waves) : null;
  for (const one of readings) {
    if (one.saturated) continue;
    const unknown = new Float64Array(n), [p, d] = one.zone;
    for (const k of [0, 1]) unknown[k] = p * point.bloodPerPa[0][k] + d * point.bloodPerPa[1][k];
    let noise = one.noiseV2;
    if (body) {
      for (const k of [0, 1]) unknown[2 + k] = p * waves[0][k] + d * waves[1][k];
      unknown[4 + one.led] = touch.led_drift * one.light;
      unknown[n - 1] = touch.lift * one.light;
      noise += (touch.reading_drift * one.light) ** 2;
    }
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) total[i][j] += (unknown[i] * unknown[j]) / noise;
  }
  // Physiological noise shapes have a prior variance of 1 and are marginalised, one after the other.
  for (let last = n - 1; last > 1; last--) {
    const own = 1 + total[last][last];
    for (let i = 0; i < last; i++) {
      for (let j = 0; j < last; j++) total[i][j] -= (total[i][last] * total[last][j]) / own;
    }
  }
  const prior = touch.prior_pa ** -2, one = total[0][0] + prior, two = total[1][1] + prior, both = total[0][1];
  const [a, b] = atForce(touch.force_per_pa, force);
  return Math.sqrt((a * a * two - 2 * a * b * both + b * b * one) / (one * two - both * both));
}

/** Noise variance of one sample of a reading by its causes, those of the body and of a worn sensor among them. [V^2] */
function noiseBudget(row, layout) {
  const touch = tables.touch;
  if (!touch.has_body) return row.noise;
  const waves = root2(atForce(touch.waves, layout.force).map((of) => of.map((x) => x * layout.rest ** 2)));
  const moved = [0, 1].map((k) => row.zone[0] * waves[0][k] + row.zone[1] * waves[1][k]), light2 = row.light ** 2;
  return { ...row.noise, "waves of the body": moved[0] ** 2 + moved[1] ** 2, drift: light2 * (touch.led_drift ** 2 + touch.reading_drift ** 2), lift: light2 * touch.lift ** 2 };
}

/** Columns whose outer products add up to a covariance of two. */
function root2([[aa, ab], [, bb]]) {
  const a = Math.sqrt(Math.max(aa, 0)), b = a > 0 ? ab / a : 0;
  return [[a, 0], [b, Math.sqrt(Math.max(bb - b * b, 0))]];
}

/** Standard error of what was made without each group of photons. */
function jackknife(values) {
  const n = values.length, mean = values.reduce((sum, x) => sum + x, 0) / n;
  return Math.sqrt(((n - 1) / n) * values.reduce((sum, x) => sum + (x - mean) ** 2, 0));
}

/** Photocurrent by light from outside on an element, and its standard error: where no photon left, what one would add. [A] */
function ambientCurrent(element, source) {
  if (source === null) return { ambientA: 0, ambientErrorA: 0 };
  const { nodesU, nodesV, aPerMm2, photonA } = tables.ambient, area = element.width * element.length, groups = aPerMm2[source].map(() => 0);
  for (const [u, v, weight] of points(element, 0.25)) {
    const [i, a] = lineNode(nodesU, u), [j, b] = lineNode(nodesV, v);
    aPerMm2[source].forEach((table, k) => {
      groups[k] += weight * area * ((1 - a) * ((1 - b) * table[i][j] + b * table[i][j + 1]) + a * ((1 - b) * table[i + 1][j] + b * table[i + 1][j + 1]));
    });
  }
  const mean = groups.reduce((sum, x) => sum + x, 0) / groups.length;
  return { ambientA: Math.max(0, mean), ambientErrorA: jackknife(groups) / (groups.length - 1) || photonA[source] };
}

/** The elements that are read of a photodiode, or all of an array: rectangles with names. */
function elementsOf(pd, wiredOnly = true) {
  const turn = (pd.turn * Math.PI) / 180, pitch = pd.pitch || pd.length, elements = [];
  for (let i = 0; i < pd.elements; i++) {
    if (wiredOnly && pd.wired && !pd.wired.includes(i)) continue;
    const along = (i - (pd.elements - 1) / 2) * pitch;
    elements.push({
      name: pd.elements === 1 ? pd.name : `${pd.name}.${i}`, u: pd.u - Math.sin(turn) * along, v: pd.v + Math.cos(turn) * along,
      width: pd.width, length: pd.length, turn, kind: pd.kind, of: pd,
    });
  }
  return elements;
}

/** A part on the other side of the nail's centre line, "u" across or "v" along; of an array the same places are read. */
function mirrored(part, axis) {
  const mirror = { ...part, [axis]: -part[axis] || 0, turn: -part.turn || 0 };
  if (axis === "v" && part.wired) mirror.wired = part.wired.map((k) => part.elements - 1 - k).reverse();
  return mirror;
}

/** The nearest centres of a part and others: [distance, [u, v], [u, v]] for each of these, the nearest first. [mm] */
function separations(part, others) {
  const centres = (one) => (one.elements ? elementsOf(one) : [one]).map(({ u, v }) => [u, v]);
  const nearest = (other) => centres(part).flatMap((a) => centres(other).map((b) => [Math.hypot(a[0] - b[0], a[1] - b[1]), a, b])).reduce((a, b) => (b[0] < a[0] ? b : a));
  return others.map(nearest).sort((a, b) => a[0] - b[0]);
}

function dieOf(led) {
  const [width, length] = tables.ledKinds[led.kind].fields.size_mm;
  return { name: led.name, u: led.u, v: led.v, width, length, turn: (led.turn * Math.PI) / 180 };
}

/** All readings of a layout under a force, one row for each LED and element, and their force resolution; and those of people. */
function evaluate(layout, cache = new Map()) {
  const at = touched(ownFinger, layout.force, layout.rest, layout.so2);
  const rows = [], elements = layout.photodiodes.flatMap((pd) => elementsOf(pd));
  // A bed with hardly any blood is the brightest; a resistor is the same under all LEDs, and has room for a lamp.
  const least = tables.polynomial.bloodFraction[0], bright = monomials([least, least, layout.so2]);
  const pairOf = (led, element) => {
    const kind = tables.ledKinds[led.kind], die = dieOf(led);
    const key = JSON.stringify([kind.colour, die.u, die.v, die.turn, die.width, die.length, element.u, element.v,
      element.turn, element.width, element.length]);
    if (!cache.has(key)) cache.set(key, readPair(die, element, colours[kind.colour]));
    return cache.get(key);
  };
  for (const element of elements) {
    const diode = tables.photodiodeKinds[element.kind], { ambientA } = ambientCurrent(element, layout.ambient ?? tables.ambient.usual);
    element.outside = ambientCurrent(element, layout.ambient);
    const lit = layout.leds.map((led) => Math.max(0, dot(bright, pairOf(led, element).coefficients)) * currentPerFraction(led, diode));
    element.ohm = tables.stage.feedbackOhm ?? fittedOhm(Math.max(0, ...lit) + ambientA + diode.darkA);
  }
  layout.leds.forEach((led, number) => {
    for (const element of elements) {
      const pair = pairOf(led, element);
      rows.push({ led: number, element, pair, ...readRow(pair, pair.coefficients, at, led, element) });
    }
  });
  if (cache.size > 4000) cache.clear();
  return { rows, state: at.state, rest: at.start, ...resolve(rows, layout.force, layout.rest, layout.leds.length), people: readPeople(layout, rows) };
}

/** The same rows and force resolution of each person, with the board's resistors and the light from outside as it is. */
function readPeople(layout, rows) {
  return people.map((person, i) => {
    const at = touched(person, layout.force, person.rest, person.so2);
    const theirs = rows.map(({ led, element, pair }) => ({ led, element, pair, ...readRow(pair, pair.people[i], at, layout.leds[led], element) }));
    return { rows: theirs, ...resolve(theirs, layout.force, person.rest, layout.leds.length, person) };
  });
}

/** Photocurrent of all of an LED's light on a photodiode. [A] */
const currentPerFraction = (led, diode) => tables.ledKinds[led.kind].fields.flux_mw * 1e-3 * diode.responsivity[led.kind];

/** One reading of a finger, by its light's coefficients; the photons' part of the errors is that of the scene's own finger. */
function readRow(pair, coefficients, at, led, element) {
  const diode = tables.photodiodeKinds[element.kind], gain = currentPerFraction(led, diode) * element.ohm, { without } = pair;
  const atRest = dot(at.rest, coefficients), now = dot(at.now, coefficients);
  const slope = at.slope.map((row) => dot(row, coefficients)), restSlope = at.restSlope.map((row) => dot(row, coefficients));
  const counted = jackknife(without[0]), few = !(atRest > 0 && now > 0) || counted > tables.fewRelative;
  const linear = without[1].map((_, k) => at.moved[0] * restSlope[0] * without[1][k] + at.moved[1] * restSlope[1] * without[2][k]);
  // What either zone's blood changes by itself, added up: both may cancel in a reading, their errors do not.
  const gross = Math.abs(at.moved[0] * slope[0]) + Math.abs(at.moved[1] * slope[1]), changeCounted = jackknife(linear);
  const light = Math.max(now, 0), read = stage(diode, (light * gain) / element.ohm, element.outside.ambientA, element.ohm);
  // What rejection subtracts leaves no error.
  const photonsV = Math.hypot(gain * now * counted, tables.stage.rejects ? 0 : element.outside.ambientErrorA * element.ohm), nodesV = gain * Math.abs(now) * tables.kernelError;
  return {
    few, fraction: now, fractionRest: atRest, gain, ...element.outside, ...read,
    fractionError: now * Math.hypot(counted, tables.kernelError),
    restError: atRest * Math.hypot(counted, tables.kernelError),
    voltsError: Math.hypot(photonsV, nodesV),
    change: (now - atRest) * gain, changeError: gain * Math.hypot(changeCounted, tables.kernelChangeError * gross), changeCounted, gross, slope,
    // Whose error is interpolation's rather than the photons'.
    interpolated: [nodesV > photonsV, tables.kernelChangeError * gross > changeCounted],
    directShare: atRest > 0 ? Math.max(0, pair.direct / atRest) : 0,
    light: light * gain, zone: slope.map((x) => x * gain), without,
  };
}

/** Force resolution of all rows, with physiological noise and of the electronics alone, with standard errors. [N] */
function resolve(rows, force, rest, ledCount, { touch } = ownFinger) {
  const usable = rows.filter((row) => !row.few);
  const scaled = (values) => values.map((row) => row.map((x) => x * rest));
  const bloodPerPa = scaled(atForce(touch.blood_per_pa, force));
  const waves = atForce(touch.waves, force).map((row) => row.map((x) => x * rest * rest));
  const resolutions = {};
  for (const [name, body] of [["throughBody", touch.has_body], ["electronics", false]]) {
    const point = { bloodPerPa, waves, body, force, touch };
    const value = forceResolution(usable, point, ledCount);
    const left = Array.from({ length: blockCount }, (_, k) => Math.log(forceResolution(usable.map((row) => ({
      ...row, light: row.light * row.without[0][k], zone: row.zone.map((x, q) => x * row.without[q + 1][k]),
    })), point, ledCount)));
    resolutions[name] = { value, error: value * Math.hypot(jackknife(left), tables.kernelResolutionError) };
  }
  return resolutions;
}

const sidesOf = (line) => line.map((point, k) => [point, line[(k + 1) % line.length]]);

/** Whether a part does not lie wholly on the drawn board: within its border, off its holes. */
function crossesBorder(part) {
  const edges = tables.board.border.flatMap(sidesOf), sides = sidesOf(corners(part));
  if (!edges.length) return false;
  const isOn = ([u, v]) => edges.filter(([[a, b], [c, d]]) => (b > v) !== (d > v) && u < ((c - a) * (v - b)) / (d - b) + a).length % 2 === 1;
  const turn = ([a, b], [c, d], [e, f]) => (c - a) * (f - b) - (d - b) * (e - a);
  const cross = ([a, b], [c, d]) => turn(a, b, c) * turn(a, b, d) < 0 && turn(c, d, a) * turn(c, d, b) < 0;
  // A small hole may lie within the part.
  const isIn = (point) => new Set(sides.map(([a, b]) => turn(a, b, point) > 0)).size === 1;
  return !corners(part).every(isOn) || edges.some((edge) => isIn(edge[0]) || sides.some((side) => cross(side, edge)));
}

/** Violated constraints of a layout, in words: overlaps, edges, the wall. Empty where it can be built. */
function problems(layout) {
  const [uMin, uMax, vMin, vMax] = tables.board.outline, violations = [];
  const parts = [...layout.leds.map(dieOf), ...layout.photodiodes.flatMap((pd) => elementsOf(pd, false))];
  for (const part of parts) {
    if (corners(part).some(([u, v]) => u <= uMin || u >= uMax || v <= vMin || v >= vMax) || crossesBorder(part)) violations.push(`${part.name} reaches over the board's edge`);
  }
  for (let i = 0; i < parts.length; i++) for (let j = 0; j < i; j++) if (overlap(parts[i], parts[j])) violations.push(`${parts[j].name} and ${parts[i].name} overlap`);
  const names = [...layout.leds, ...layout.photodiodes].map((part) => part.name);
  if (new Set(names).size < names.length) violations.push("two parts have one name");
  if (!layout.leds.length) violations.push("there is no LED");
  if (!layout.photodiodes.length) violations.push("there is no photodiode");
  if (tables.board.wall && layout.leds.length && layout.photodiodes.length) violations.push(...wallProblems(layout));
  return [...new Set(violations)];
}

function box(parts) {
  const all = parts.flatMap(corners), us = all.map((p) => p[0]), vs = all.map((p) => p[1]);
  return { uMin: Math.min(...us), uMax: Math.max(...us), vMin: Math.min(...vs), vMax: Math.max(...vs) };
}

/** Edges of a box along the way from LEDs on a side to their photodiodes: the near one, then the far one. */
function span(area, side) {
  const [low, high] = side === "left" || side === "right" ? [area.uMin, area.uMax] : [area.vMin, area.vMax];
  return side === "left" || side === "below" ? [low, high] : [-high, -low];
}

/** Free width between an LED and the wall, or what else lies on that side of it, as a scene's layout takes it. */
const gapTo = (area, led, side) => span(area, side)[0] - span(box([dieOf(led)]), side)[1];

function wallProblems(layout) {
  const wall = tables.board.wall, diodes = box(layout.photodiodes.flatMap((pd) => elementsOf(pd, false))), violations = [];
  for (const led of layout.leds) {
    const widest = ["left", "right", "below", "above"].reduce((a, b) => (gapTo(diodes, led, b) > gapTo(diodes, led, a) ? b : a));
    if (gapTo(wall, led, wall.side) < 0.02) violations.push(`${led.name} is on the wall or behind it`);
    else if (gapTo(diodes, led, widest) > gapTo(diodes, led, wall.side) + 1e-9) violations.push(`${led.name} lies ${widest} all photodiodes, where a scene would put its wall`);
  }
  if (span(diodes, wall.side)[0] - span(wall, wall.side)[1] < 0.02) violations.push("a photodiode is on the wall or before it");
  return violations;
}

function corners({ u, v, width, length, turn }) {
  const cos = Math.cos(turn), sin = Math.sin(turn);
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
    const x = (a * width) / 2, y = (b * length) / 2;
    return [u + cos * x - sin * y, v + sin * x + cos * y];
  });
}

/** Whether two turned rectangles overlap: none of their sides' directions parts them. */
function overlap(one, other) {
  const a = corners(one), b = corners(other);
  for (const turn of [one.turn, one.turn + Math.PI / 2, other.turn, other.turn + Math.PI / 2]) {
    const along = ([u, v]) => u * Math.cos(turn) + v * Math.sin(turn), pa = a.map(along), pb = b.map(along);
    if (Math.max(...pa) <= Math.min(...pb) + 1e-6 || Math.max(...pb) <= Math.min(...pa) + 1e-6) return false;
  }
  return true;
}

// ---------------------------------------------------------------------------------------------------- the layout

/** The scene's own layout, from the nail's centre. */
function ownLayoutOf({ leds, photodiodes, board, touch, blood }) {
  const [du, dv] = board.center_mm, fieldsOf = (part) => JSON.stringify(Object.entries(part).filter(([key]) => !tables.placed.includes(key)));
  const placed = (part, kinds) => ({
    name: part.name, u: part.position_mm[0] + du, v: part.position_mm[1] + dv, turn: part.rotation_deg, reference: part.reference ?? null,
    kind: kinds.findIndex((kind) => fieldsOf(kind.fields) === fieldsOf(part)),
  });
  const diodeKinds = tables.photodiodeKinds;
  return {
    leds: leds.map((led) => placed(led, tables.ledKinds)),
    photodiodes: photodiodes.map((pd) => ({
      ...placed(pd, diodeKinds), width: pd.size_mm[0], length: pd.size_mm[1], elements: pd.elements, pitch: pd.pitch_mm ?? null, wired: pd.wired ?? null,
    })),
    force: touch.force_n || 1, rest: blood.rest_blood_fraction, so2: blood.so2, ambient: tables.ambient.sun,
  };
}

/** A layout as plain data, short enough for a link. */
function packed(layout) {
  const short = (x) => Math.round(x * 1e4) / 1e4, own = (p) => (p.reference ? [p.reference] : []);
  return [1, layout.leds.map((p) => [p.name, p.kind, short(p.u), short(p.v), short(p.turn), ...own(p)]),
    layout.photodiodes.map((p) => [p.name, p.kind, short(p.u), short(p.v), short(p.turn), p.width, p.length, p.elements, p.pitch, p.wired, ...own(p)]),
    layout.force, layout.rest, layout.so2, layout.ambient];
}

function unpacked([, leds, photodiodes, force, rest, so2, ambient]) {
  return {
    leds: leds.map(([name, kind, u, v, turn, reference = null]) => ({ name, kind, u, v, turn, reference })),
    photodiodes: photodiodes.map(([name, kind, u, v, turn, width, length, elements, pitch, wired, reference = null]) =>
      ({ name, kind, u, v, turn, width, length, elements, pitch, wired, reference })),
    force, rest, so2, ambient,
  };
}

const toLink = (layout) => btoa(unescape(encodeURIComponent(JSON.stringify(packed(layout))))).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");

/** The layout of a link; throws an Error that says why it has none. */
function fromLink(text) {
  let packed;
  try {
    packed = JSON.parse(decodeURIComponent(escape(atob(text.replace(/-/g, "+").replace(/_/g, "/")))));
  } catch { throw new Error("it holds no layout"); }
  if (!Array.isArray(packed) || packed[0] !== 1 || ![packed[1], packed[2]].every((list) => Array.isArray(list) && list.every(Array.isArray))) throw new Error("it holds no layout");
  return checkedLayout(unpacked(packed));
}

/** The layout as the tables of a scene, ready for TOML. */
function toScene(layout) {
  const scene = structuredClone(tables.scene), [cu, cv] = tables.board.center, round = (x) => Math.round(x * 1e6) / 1e6;
  scene.leds = layout.leds.map((led) => ({
    ...structuredClone(tables.ledKinds[led.kind].fields), name: led.name, ...(led.reference && { reference: led.reference }),
    position_mm: [round(led.u - cu), round(led.v - cv)], rotation_deg: led.turn,
  }));
  scene.photodiodes = layout.photodiodes.map((pd) => {
    const fields = { ...structuredClone(tables.photodiodeKinds[pd.kind].fields), name: pd.name, elements: pd.elements };
    if (pd.reference) fields.reference = pd.reference;
    fields.position_mm = [round(pd.u - cu), round(pd.v - cv)];
    fields.size_mm = [pd.width, pd.length];
    fields.rotation_deg = pd.turn;
    delete fields.wired;
    delete fields.pitch_mm;
    if (pd.wired) fields.wired = pd.wired;
    if (pd.pitch) fields.pitch_mm = pd.pitch;
    return fields;
  });
  if (tables.stage.feedbackOhm === null) scene.electronics.feedback_ohm = "auto";
  const wall = tables.board.wall;
  if (wall) scene.board.barrier_gap_mm = round(Math.min(...layout.leds.map((led) => gapTo(wall, led, wall.side))));
  scene.blood.rest_blood_fraction = layout.rest;
  if (scene.blood.venous_so2 !== undefined) scene.blood.venous_so2 = round(Math.max(0, layout.so2 - (scene.blood.so2 - scene.blood.venous_so2)));
  scene.blood.so2 = layout.so2;
  if (scene.touch.force_n !== undefined && layout.force > 0) scene.touch.force_n = layout.force;
  const names = new Set([...layout.leds.map((led) => led.name), "dark"]);
  if (scene.oximeter && (scene.oximeter.slots || []).some((slot) => !names.has(slot.light))) delete scene.oximeter;
  return scene;
}

/** A dropped scene's parts on this page's board; whatever else it says stays as it is here. Throws an Error. */
function fromScene(scene, before) {
  if (scene.phantom) throw new Error("a phantom has no board; open a scene with a finger.");
  const why = broken(scene, tables.rules.scene, "");
  if (why) throw new Error(`${why}.`);
  const [cu, cv] = (scene.board && scene.board.center_mm) || [0, 0];
  const place = (part) => { const [u, v] = part.position_mm || [0, 0]; return { u: u + cu, v: v + cv, turn: part.rotation_deg || 0 }; };
  const leds = (scene.leds || []).map((led) => {
    let kind = tables.ledKinds.findIndex((one) => one.fields.part && one.fields.part === led.part && led.wavelength_nm === undefined);
    if (kind < 0) kind = tables.ledKinds.findIndex((one) => Math.abs(one.fields.wavelength_nm - led.wavelength_nm) < tables.sameNm);
    if (kind < 0) throw new Error(`LED ${led.name}: ${led.wavelength_nm || led.part} is not a wavelength of this page; make a page of that scene.`);
    return { name: led.name, reference: led.reference || null, kind, ...place(led) };
  });
  const photodiodes = (scene.photodiodes || []).map((pd) => {
    const part = pd.part || pd.array, kind = Math.max(0, tables.photodiodeKinds.findIndex((one) => one.fields.part && one.fields.part === part));
    const usual = tables.photodiodeKinds[kind].fields, [width, length] = pd.size_mm || (part ? usual : { size_mm: tables.rules.scene.$defs.Photodiode.properties.size_mm.default }).size_mm;
    return {
      name: pd.name || part, reference: pd.reference || null, kind, ...place(pd), width, length, elements: pd.elements || (part ? usual.elements : 1),
      pitch: pd.pitch_mm || (part ? usual.pitch_mm : null) || null, wired: pd.wired || null,
    };
  });
  if (!leds.length || !photodiodes.length) throw new Error("this scene has no LEDs or no photodiodes.");
  const blood = scene.blood || {}, touch = scene.touch || {};
  return checkedLayout({ ...before, leds, photodiodes, rest: blood.rest_blood_fraction ?? before.rest, so2: blood.so2 ?? before.so2, force: touch.force_n ?? before.force });
}

/** The layout as a position file in KiCad's form, all on the bottom, which faces the nail; with a file's references. */
function toPositions(layout) {
  const lines = ["Ref,Val,Package,PosX,PosY,Rot,Side"], number = (x) => (x + 0).toFixed(6), turn = (deg) => ((deg % 360) + 360) % 360;
  // A text that a spreadsheet would run as a formula stands behind an apostrophe, which `place` and `check` take away.
  const cell = (text) => `"${(tables.formula.includes(text[0]) ? "'" : "") + text.split(/[\r\n\v\f\x1c-\x1e\x85\u2028\u2029]+/).join(" ").replace(/"/g, '""')}"`;
  const line = (texts, { u, v }, deg) => lines.push([...texts.map(cell), number(u), number(v), number(turn(deg)), "bottom"].join(","));
  const known = [...layout.leds, ...layout.photodiodes].some((part) => part.reference);
  layout.leds.forEach((led, i) => line([led.reference || (known ? led.name : `D${i + 1}`), led.name, "LED_die"], led, led.turn));
  layout.photodiodes.flatMap((pd) => elementsOf(pd)).forEach((element, i) => {
    const { of, name } = element, ref = of.reference ? of.reference + name.slice(of.name.length) : known ? name : `PD${i + 1}`;
    line([ref, name, `PD_${element.width}x${element.length}mm`], element, of.turn);
  });
  return lines.join("\n") + "\n";
}
