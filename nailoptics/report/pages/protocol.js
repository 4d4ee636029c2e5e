"use strict";
// The line of a protocol, which moves past a mark that says what to press now, beside bars of that and of what is measured.
const drawn = JSON.parse(document.getElementById("protocol").textContent);
const [canvas, whole, button, words] = ["line", "whole", "start", "now"].map((id) => document.getElementById(id));
const BEFORE_S = 2, AFTER_S = 10, BARS = 150, MOST_N = 1.08 * Math.max(...drawn.force_n);
const end_s = drawn.time_s.at(-1);
let paused_s = 0, started_ms = null, measured = null, has_ended = false;

function at(time_s, values) {
  const k = drawn.time_s.findIndex((corner_s) => corner_s > time_s);
  if (k < 1) return k ? values.at(-1) : values[0];
  const part = (time_s - drawn.time_s[k - 1]) / (drawn.time_s[k] - drawn.time_s[k - 1]);
  return values[k - 1] + part * (values[k] - values[k - 1]);
}

// Time on the line: that of the newest sample where force is measured, else of the button's clock. [s]
const clock_s = () => measured ? Math.min(end_s, measured.time_s)
  : Math.min(end_s, paused_s + (started_ms === null ? 0 : (performance.now() - started_ms) / 1000));
const side = (time_s) => at(time_s, drawn.proximal_share) >= 0.5 ? "proximal" : "distal";

// A pen on a canvas as large as it is shown, and its functions to draw and write in a colour of the page.
function pen_on(canvas) {
  const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * devicePixelRatio;
  canvas.height = height * devicePixelRatio;
  pen.scale(devicePixelRatio, devicePixelRatio);
  pen.font = "13px " + style.getPropertyValue("--type");
  const colour = (name) => style.getPropertyValue(`--${name}`);
  const stroke = (name, wide, points) => {
    pen.strokeStyle = colour(name);
    pen.lineWidth = wide;
    pen.beginPath();
    points.forEach((point) => pen.lineTo(...point));
    pen.stroke();
  };
  const fill = (name, ...corners) => {
    pen.fillStyle = colour(name);
    pen.fillRect(...corners);
  };
  const write = (name, text, ...place) => {
    pen.fillStyle = colour(name);
    pen.fillText(text, ...place);
  };
  return { width, height, stroke, fill, write };
}

function draw_line(now_s) {
  const { width, height, stroke, fill, write } = pen_on(canvas);
  const right = width - BARS, left = 30;
  const x = (time_s) => left + (right - left) * (time_s - now_s + BEFORE_S) / (BEFORE_S + AFTER_S);
  const y = (force_n) => height - 24 - (height - 34) * force_n / MOST_N;
  for (let force_n = 0; force_n <= MOST_N; force_n += 0.5) {
    stroke("grid", 1, [[left, y(force_n)], [width, y(force_n)]]);
    write("muted", force_n.toFixed(1), 2, y(force_n) + 4);
  }
  write("muted", "force [N]", left + 4, 12);
  const inside = drawn.time_s.filter((time_s) => x(time_s) > left && x(time_s) < right);
  const times_s = [Math.max(0, now_s - BEFORE_S), ...inside, Math.min(end_s, now_s + AFTER_S)];
  stroke("accent", 3, times_s.map((time_s) => [x(time_s), y(at(time_s, drawn.force_n))]));
  stroke("ink", 1.5, [[x(now_s), 4], [x(now_s), height - 20]]);
  const bars = [["to press", "accent", at(now_s, drawn.force_n)]];
  if (measured) bars.push(["measured", "ink", measured.force_n]);
  bars.forEach(([name, tone, force_n], k) => {
    const from = right + 16 + 68 * k, top = y(Math.min(Math.max(force_n, 0), MOST_N));
    fill(tone, from, top, 44, y(0) - top + 1);
    write(tone, name, from - 4, height - 6);
    write(tone, force_n.toFixed(2), from + 8, top - 5);
  });
}

function draw_whole(now_s) {
  const { width, height, stroke, fill, write } = pen_on(whole), left = 30, bottom = height - 18;
  const x = (time_s) => left + (width - left - 4) * time_s / end_s, y = (force_n) => bottom - (bottom - 16) * force_n / MOST_N;
  drawn.time_s.forEach((time_s, k) => {
    if (!drawn.proximal_share[k] && k) fill("panel", x(drawn.time_s[k - 1]), 0, x(time_s) - x(drawn.time_s[k - 1]), bottom);
  });
  for (let force_n = 0; force_n <= MOST_N; force_n += 1) {
    stroke("grid", 1, [[left, y(force_n)], [width, y(force_n)]]);
    write("muted", force_n.toFixed(0), 14, y(force_n) + 4);
  }
  for (let minute = 0; x(60 * minute) < width - 90; minute += 1) {
    stroke("grid", 1, [[x(60 * minute), bottom], [x(60 * minute), bottom + 4]]);
    write("muted", minute.toFixed(0), x(60 * minute) - 4, height - 2);
  }
  write("muted", "force [N]", left + 4, 12);
  write("muted", "time [min]", width - 70, height - 2);
  stroke("accent", 1, drawn.time_s.map((time_s, k) => [x(time_s), y(drawn.force_n[k])]));
  stroke("ink", 1.5, [[x(now_s), 0], [x(now_s), bottom]]);
}

// The end of the rest in which the sensor is to be taken off and put on again; undefined outside it. [s]
function back_on_s(now_s) {
  const k = drawn.time_s.findIndex((corner_s) => corner_s > now_s);
  return k > 0 && drawn.is_off[k - 1] ? drawn.time_s[k] : undefined;
}

function draw() {
  const now_s = clock_s(), back_s = back_on_s(now_s);
  const other_s = drawn.time_s.find((time_s) => time_s > now_s && side(time_s) !== side(now_s));
  draw_line(now_s);
  draw_whole(now_s);
  const change = other_s === undefined ? "" : `; the other side in ${Math.ceil(other_s - now_s)} s`;
  words.textContent = now_s >= end_s ? "Done: the protocol is complete."
    : has_ended ? "No more force is piped in."
    : back_s !== undefined ? `Take the sensor off and put it on again within ${Math.ceil(back_s - now_s)} s.`
    : `${at(now_s, drawn.force_n) ? "Press" : "Rest. Next is"} the ${side(now_s)} side. `
      + `${Math.ceil(end_s - now_s)} s are left${change}.`;
}

button.addEventListener("click", () => {
  paused_s = clock_s() < end_s ? clock_s() : 0;
  started_ms = started_ms === null || !paused_s ? performance.now() : null;
  button.textContent = started_ms === null ? "Go on" : "Pause";
});

// A page that is served reads the newest sample from there.
async function listen() {
  try {
    const sample = await (await fetch("force", { cache: "no-store" })).json();
    if (sample.time_s !== undefined) measured = sample;
    setTimeout(listen, 40);
  } catch {
    has_ended = true;
  }
}
button.hidden = drawn.is_served;
if (drawn.is_served) listen();
(function frame() {
  draw();
  requestAnimationFrame(frame);
})();
