// What a layout and a scene must keep before this page shows them: the JSON Schemas of Python's own models, but for what
// must be given, of which a part may fill in some.

/** Why a value breaks a JSON Schema, with its place; empty where it keeps it. Knows the keywords that models make. */
function broken(value, schema, place) {
  if (schema.$ref) return broken(value, tables.rules.scene.$defs[schema.$ref.split("/").pop()], place);
  if (schema.anyOf) {
    const reasons = schema.anyOf.map((one) => broken(value, one, place));
    return reasons.includes("") ? "" : reasons.find((_, k) => isOf(schema.anyOf[k].type, value)) || reasons[0];
  }
  const name = place || "the file", shown = value && typeof value === "object" ? "" : ` = ${String(value).slice(0, 40)}`, choices = schema.enum || ("const" in schema ? [schema.const] : null);
  if (schema.type && !isOf(schema.type, value)) return `${name}${shown} is no ${schema.type}`;
  if (choices && !choices.includes(value)) return `${name}${shown} must be ${choices.join(" or ")}`;
  for (const [rule, holds] of Object.entries(RULES)) {
    if (rule in schema && !holds(value, schema[rule])) return `${name}${shown} breaks the rule ${rule} ${schema[rule]}`;
  }
  return brokenInside(value, schema, place);
}

const isOf = (type, value) => ({
  null: value === null, number: typeof value === "number" && Number.isFinite(value), integer: Number.isInteger(value), string: typeof value === "string",
  boolean: typeof value === "boolean", array: Array.isArray(value), object: value !== null && typeof value === "object" && !Array.isArray(value),
}[type] ?? true);

const RULES = {
  minimum: (x, least) => x >= least, maximum: (x, most) => x <= most,
  exclusiveMinimum: (x, least) => x > least, exclusiveMaximum: (x, most) => x < most,
  minItems: (x, least) => x.length >= least, maxItems: (x, most) => x.length <= most,
  maxLength: (x, most) => x.length <= most, pattern: (x, form) => new RegExp(form).test(x),
};

function brokenInside(value, schema, place) {
  const within = (key) => (place ? `${place}.${key}` : key);
  for (const [k, one] of (Array.isArray(value) ? value : []).entries()) {
    const rule = (schema.prefixItems || [])[k] || schema.items, why = rule ? broken(one, rule, `${place}[${k}]`) : "";
    if (why) return why;
  }
  for (const [key, one] of schema.type === "object" ? Object.entries(value) : []) {
    const known = schema.properties && Object.hasOwn(schema.properties, key), rule = known ? schema.properties[key] : schema.additionalProperties;
    if (rule === false) return `${within(key)} is not a field`;
    const why = typeof rule === "object" ? broken(one, rule, within(key)) : "";
    if (why) return why;
  }
  return "";
}

// No part of a layout lies farther from the nail's centre. [mm]
const FARTHEST_MM = 1e3;

/** A layout that came from outside, if it keeps what a scene must and this page can show it; throws an Error. */
function checkedLayout(layout) {
  const { rules } = tables, ranges = { force: [0, tables.touch.force_n.at(-1)], rest: tables.restRange, so2: tables.polynomial.so2 };
  const within = (x, low, high) => Number.isFinite(x) && x >= low && x <= high, isChoice = (k, all) => Number.isInteger(k) && k in all;
  for (const [name, [low, high]] of Object.entries(ranges)) if (!within(layout[name], low, high)) throw new Error(`${name} = ${layout[name]} is not in ${low} to ${high}`);
  if (layout.ambient !== null && !isChoice(layout.ambient, tables.ambient.names)) throw new Error(`ambient = ${layout.ambient} is no light of this page`);
  for (const [list, kinds] of [["leds", tables.ledKinds], ["photodiodes", tables.photodiodeKinds]]) {
    layout[list].forEach(({ kind, u, v }, k) => {
      if (!isChoice(kind, kinds)) throw new Error(`${list}[${k}].kind = ${kind} is no part of this page`);
      if (![u, v].every((x) => within(x, -FARTHEST_MM, FARTHEST_MM))) throw new Error(`${list}[${k}] lies at ${u}, ${v}, which is no place`);
    });
  }
  // All else by the scene that it makes; without an LED there is none yet.
  const { leds, photodiodes, blood } = toScene(layout), why = broken({ ...(leds.length && { leds }), photodiodes, blood }, rules.scene, "");
  if (why) throw new Error(why);
  const elements = layout.photodiodes.reduce((sum, pd) => sum + pd.elements, 0), pairs = layout.leds.length * elements;
  if (elements > rules.mostElements) throw new Error(`photodiodes have ${elements} elements; at most ${rules.mostElements}`);
  if (pairs > rules.mostPairs) throw new Error(`${pairs} pairs of an LED and a photodiode are more than this page shows, ${rules.mostPairs}`);
  for (const { name, wired, elements: count, pitch, length } of layout.photodiodes) {
    if (wired && (!wired.length || wired.some((k) => k >= count) || new Set(wired).size < wired.length)) throw new Error(`${name}: wired must name elements 0 to ${count - 1}, each once`);
    if (count > 1 && pitch !== null && pitch < length) throw new Error(`${name}: pitch_mm = ${pitch} is less than the element's size along v, ${length}`);
  }
  return layout;
}
