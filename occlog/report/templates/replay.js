// The moments of a run: a plan to scrub and play, its values in words, and a cursor in every figure over time.
// Everything comes from the element #replay-data, which holds JSON and is never executed; text is set as text.
"use strict";
(() => {
  const source = document.getElementById("replay-data");
  const root = document.getElementById("replay");
  const themes = document.getElementById("themes");

  // ---- light and dark
  if (themes) {
    themes.hidden = false;
    themes.addEventListener("change", (event) => {
      const value = event.target.value;
      if (value === "system") document.documentElement.removeAttribute("data-theme");
      else document.documentElement.setAttribute("data-theme", value);
      draw();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
  }
  if (!source || !root) return;
  const data = JSON.parse(source.textContent);
  root.hidden = false;

  // ---- numbers: arrays come as base64 of little-endian values
  const KINDS = { f8: Float64Array, u4: Uint32Array, u2: Uint16Array, i2: Int16Array, u1: Uint8Array, i1: Int8Array };
  const unpack = ([kind, text, value]) => {
    if (kind === "=") return new Float64Array(text).fill(value);
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new KINDS[kind](bytes.buffer);
  };
  const table = (packed) => {
    const out = {};
    for (const [name, value] of Object.entries(packed || {})) out[name] = unpack(value);
    return out;
  };
  const times = unpack(data.times);
  const tracks = table(data.tracks), truth = table(data.truth), sight = table(data.sight), hulls = table(data.hulls);
  const [low, high] = data.limits;
  const centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const place = (columns, i) => [centre[0] + columns.x[i] * data.step, centre[1] + columns.y[i] * data.step];
  const beyond = (columns, i) => Math.abs(columns.x[i]) >= 32767 || Math.abs(columns.y[i]) >= 32767;
  const rowsOf = (columns, m) => (columns.first ? [columns.first[m], columns.first[m + 1]] : [0, 0]);
  const NONE = 65535;
  const $ = (id) => document.getElementById(id);
  const shown = (layer) => $(`layer-${layer}`)?.checked;
  const hiddenTargets = new Set();
  const palette = () => getComputedStyle(document.documentElement);
  const colourOf = (style, index) => style.getPropertyValue(`--t${index % 6}`).trim();

  // ---- the plan
  const canvas = $("replay-plan"), pen = canvas.getContext("2d");
  let width = 0, height = 0, scale = 1, now = 0, playing = false, hovered = null, speed = 1;
  const px = ([x, y]) => [(x - low[0]) * scale, (high[1] - y) * scale];

  const fit = () => {
    const ratio = window.devicePixelRatio || 1;
    const size = [high[0] - low[0], high[1] - low[1]];
    width = canvas.parentElement.clientWidth;
    scale = Math.min(width / size[0], Math.max(260, 0.72 * window.innerHeight) / size[1]);
    width = size[0] * scale;
    height = size[1] * scale;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  };
  const trace = (points, closed) => {
    pen.beginPath();
    points.forEach((point, k) => (k ? pen.lineTo(...px(point)) : pen.moveTo(...px(point))));
    if (closed) pen.closePath();
  };
  const ellipse = ([x, y], sx, sy, rho) => {
    // Half axes of the ellipse that holds 95 % of a Gaussian: roots of the eigenvalues of its covariance
    const a = sx * sx, b = sy * sy, c = rho * sx * sy;
    const mean = (a + b) / 2, half = Math.hypot((a - b) / 2, c);
    const root95 = (v) => Math.sqrt(data.ellipse * Math.max(v, 0)) * scale;
    pen.beginPath();
    pen.ellipse(...px([x, y]), root95(mean + half), root95(mean - half), -Math.atan2(2 * c, a - b) / 2, 0, 2 * Math.PI);
  };

  // People of a moment
  const peopleAt = (m) => {
    const out = [];
    const [from, to] = rowsOf(tracks, m);
    for (let i = from; i < to; i++) {
      const target = tracks.target[i];
      out.push({
        target, row: i, at: place(tracks, i), outside: beyond(tracks, i),
        sx: tracks.sx[i] * data.sigma, sy: tracks.sy[i] * data.sigma, rho: tracks.rho[i] / 127,
        known: tracks.sx[i] < NONE, existence: tracks.existence[i] === 255 ? null : tracks.existence[i] / 254,
        seen: data.words.seen[tracks.seen[i]], doubt: data.words.doubt[tracks.doubt[i]],
        width: tracks.width[i] ? tracks.width[i] * data.size : data.body[0],
        height: tracks.height[i] ? tracks.height[i] * data.size : data.body[1],
      });
    }
    return out;
  };
  const truthAt = (m) => {
    const out = new Map(), others = [];
    const [from, to] = rowsOf(truth, m);
    for (let i = from; i < to; i++) {
      if (truth.target[i] === NONE) others.push(place(truth, i));
      else out.set(truth.target[i], place(truth, i));
    }
    return { targets: out, others };
  };

  // The part of the floor that a body hides from a camera: between its two tangents, as far as its shadow reaches
  const shadow = (camera, at, bodyWidth, bodyHeight) => {
    const dx = at[0] - camera.x, dy = at[1] - camera.y, far = Math.hypot(dx, dy), r = bodyWidth / 2;
    if (far <= r || (camera.fov < 6.28 && turn(Math.atan2(dy, dx) - camera.yaw) > camera.fov / 2 + 0.1)) return null;
    const reach = camera.z > bodyHeight ? (far * camera.z) / (camera.z - bodyHeight) : 1e4 * (high[0] - low[0]);
    const middle = Math.atan2(dy, dx), half = Math.asin(r / far), near = Math.sqrt(far * far - r * r);
    const end = Math.min(reach, 4 * Math.hypot(high[0] - low[0], high[1] - low[1]));
    const point = (angle, d) => [camera.x + d * Math.cos(angle), camera.y + d * Math.sin(angle)];
    return end <= near ? null : { middle, half, far, end, corners: [point(middle - half, near), point(middle - half, end),
      point(middle + half, end), point(middle + half, near)] };
  };
  const turn = (angle) => Math.abs(Math.atan2(Math.sin(angle), Math.cos(angle)));
  // Who stands between a camera and a person that it does not see
  const hiders = (person, people) => {
    const out = [];
    if (person.seen === null) return out;
    const seeing = new Set(person.seen.split(","));
    for (const camera of data.sensors) {
      if (camera.kind !== "camera" || seeing.has(camera.name)) continue;
      const dx = person.at[0] - camera.x, dy = person.at[1] - camera.y;
      const far = Math.hypot(dx, dy), angle = Math.atan2(dy, dx);
      if (turn(angle - camera.yaw) > camera.fov / 2 || far > camera.range) continue;
      for (const other of people) {
        if (other === person) continue;
        const dark = shadow(camera, other.at, other.width, other.height);
        if (dark && dark.far < far && far < dark.end && turn(angle - dark.middle) < dark.half) {
          out.push(`${data.targets[other.target]} from ${camera.name}`);
        }
      }
    }
    return out;
  };

  const draw = () => {
    if (!width) return;
    const style = palette(), ink = style.getPropertyValue("--ink").trim(), muted = style.getPropertyValue("--muted").trim();
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    pen.clearRect(0, 0, width, height);
    pen.globalAlpha = 1;
    pen.setLineDash([]);
    if (data.room) {
      trace(data.room, true);
      pen.fillStyle = colour("room");
      pen.fill();
    }
    if (shown("views")) {
      for (const sensor of data.sensors) {
        if (!sensor.view) continue;
        trace(sensor.view, true);
        pen.globalAlpha = Math.min(0.1, 1.2 / data.sensors.length);
        pen.fillStyle = colour("view");
        pen.fill();
        pen.globalAlpha = 1;
      }
    }
    const people = peopleAt(now).filter((p) => !hiddenTargets.has(p.target));
    const real = truthAt(now);
    if (shown("shadows")) {
      const bodies = people.map((p) => [p.at, p.width, p.height])
        .concat(real.others.map((at) => [at, data.body[0], data.body[1]]));
      pen.fillStyle = ink;
      pen.globalAlpha = 0.09;
      for (const camera of data.sensors) {
        if (camera.kind !== "camera" || !camera.view) continue;
        pen.save();
        trace(camera.view, true);
        pen.clip();
        for (const [at, w, h] of bodies) {
          const dark = shadow(camera, at, w, h);
          if (dark) {
            trace(dark.corners, true);
            pen.fill();
          }
        }
        pen.restore();
      }
      pen.globalAlpha = 1;
    }
    for (const polygon of data.occluders) {
      trace(polygon, true);
      pen.fillStyle = colour("pillar");
      pen.fill();
      pen.strokeStyle = colour("wall");
      pen.lineWidth = 1;
      pen.stroke();
    }
    if (data.room) {
      trace(data.room, true);
      pen.strokeStyle = colour("wall");
      pen.lineWidth = 2;
      pen.stroke();
    }
    // What moves and is not a target: where it is, and what the tracker was told of it
    pen.fillStyle = muted;
    for (const at of real.others) {
      const [x, y] = px(at), r = Math.max((data.body[0] / 2) * scale, 2);
      pen.globalAlpha = 0.5;
      pen.beginPath();
      pen.arc(x, y, r, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.globalAlpha = 1;
    if (shown("priors") && hulls.first) {
      const [from, to] = rowsOf(hulls, now - (now % data.priorsEvery));
      pen.strokeStyle = colour("moving");
      pen.lineWidth = 1.2;
      let polygon = [];
      for (let i = from; i <= to; i++) {
        if (i === to || hulls.corner[i] === 0) {
          if (polygon.length) {
            trace(polygon, true);
            pen.stroke();
          }
          polygon = [];
        }
        if (i < to) polygon.push(place(hulls, i));
      }
    }
    if (shown("sight") && sight.first) {
      const [from, to] = rowsOf(sight, now - (now % data.sightEvery));
      const where = new Map(people.map((p) => [p.target, p.at]));
      for (let i = from; i < to; i++) {
        const sensor = data.sensors[sight.sensor[i]], target = sight.target[i];
        if (hiddenTargets.has(target)) continue;
        const angle = (sight.angle[i] * 2 * Math.PI) / 65536, at = where.get(target);
        const reach = at ? Math.hypot(at[0] - sensor.x, at[1] - sensor.y) : 0.35 * Math.hypot(high[0] - low[0], high[1] - low[1]);
        const to2 = [sensor.x + reach * Math.cos(angle), sensor.y + reach * Math.sin(angle)];
        trace([[sensor.x, sensor.y], to2], false);
        pen.strokeStyle = target === NONE ? muted : colourOf(style, target);
        pen.globalAlpha = 0.55;
        pen.lineWidth = 1;
        pen.stroke();
      }
      pen.globalAlpha = 1;
    }
    drawTrails(style, ink);
    for (const [target, at] of real.targets) {
      if (hiddenTargets.has(target) || !shown("truth")) continue;
      const [x, y] = px(at);
      pen.strokeStyle = ink;
      pen.lineWidth = 1.6;
      pen.beginPath();
      pen.moveTo(x - 5, y - 5);
      pen.lineTo(x + 5, y + 5);
      pen.moveTo(x - 5, y + 5);
      pen.lineTo(x + 5, y - 5);
      pen.stroke();
    }
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "middle";
    for (const person of people) {
      if (person.outside) continue;
      const unsure = person.doubt !== "" || person.seen === "";
      pen.strokeStyle = pen.fillStyle = colourOf(style, person.target);
      if (shown("ellipses") && person.known) {
        ellipse(person.at, person.sx, person.sy, person.rho);
        pen.setLineDash(unsure ? [4, 3] : []);
        pen.lineWidth = 1.4;
        pen.stroke();
        pen.setLineDash([]);
      }
      const [x, y] = px(person.at);
      pen.beginPath();
      pen.arc(x, y, hovered === person.target ? 6 : 4, 0, 2 * Math.PI);
      if (unsure) {
        pen.lineWidth = 1.8;
        pen.stroke();
      } else pen.fill();
      if (shown("names")) pen.fillText(String(data.targets[person.target]), x + 8, y - 8);
    }
    pen.fillStyle = ink;
    for (const sensor of data.sensors) {
      const [x, y] = px([sensor.x, sensor.y]);
      pen.fillRect(x - 3, y - 3, 6, 6);
      if (shown("names")) {
        pen.textAlign = x > width - 60 ? "right" : "left";
        pen.fillText(sensor.name, x + (x > width - 60 ? -7 : 7), Math.min(Math.max(y, 9), height - 9));
        pen.textAlign = "left";
      }
    }
    drawStrip(style);
  };

  const drawTrails = (style, ink) => {
    const length = Number($("replay-trail").value);
    if (!length) return;
    const trails = (columns, ends, dash, alpha) => {
      if (!columns.first) return;
      const paths = new Map();
      let m = now;
      while (m > 0 && times[m - 1] >= times[now] - length) m--;
      for (; m <= now; m++) {
        const [from, to] = rowsOf(columns, m);
        for (let i = from; i < to; i++) {
          const target = columns.target[i];
          if (target === NONE || hiddenTargets.has(target) || beyond(columns, i)) continue;
          if (!paths.has(target)) paths.set(target, []);
          paths.get(target).push(place(columns, i));
        }
      }
      for (const [target, points] of paths) {
        trace(points, false);
        pen.strokeStyle = ends || colourOf(style, target);
        pen.setLineDash(dash);
        pen.globalAlpha = alpha;
        pen.lineWidth = ends ? 1 : 2;
        pen.stroke();
      }
      pen.setLineDash([]);
      pen.globalAlpha = 1;
    };
    if (shown("truth")) trails(truth, ink, [4, 3], 0.7);
    trails(tracks, "", [], 0.7);
  };

  // ---- the strip above the slider: largest error of each moment, or how many are there; events below it
  const strip = $("replay-strip"), stripPen = strip.getContext("2d");
  const series = new Float64Array(times.length);
  const compared = data.same && truth.first && truth.target.some((t) => t < data.targets.length);
  for (let m = 0; m < times.length; m++) {
    if (!compared) {
      const [from, to] = rowsOf(tracks, m);
      series[m] = to - from;
      continue;
    }
    const real = truthAt(m).targets;
    for (const person of peopleAt(m)) {
      const at = real.get(person.target);
      if (at && !person.outside) series[m] = Math.max(series[m], Math.hypot(at[0] - person.at[0], at[1] - person.at[1]));
    }
  }
  const top = series.reduce((a, b) => Math.max(a, b), 0) || 1;
  const span = times[times.length - 1] - times[0] || 1;
  const drawStrip = (style) => {
    const ratio = window.devicePixelRatio || 1, w = strip.clientWidth, h = strip.clientHeight;
    if (strip.width !== Math.round(w * ratio)) {
      strip.width = Math.round(w * ratio);
      strip.height = Math.round(h * ratio);
    }
    stripPen.setTransform(ratio, 0, 0, ratio, 0, 0);
    stripPen.clearRect(0, 0, w, h);
    const at = (t) => 8 + ((t - times[0]) / span) * (w - 16);
    stripPen.beginPath();
    stripPen.moveTo(at(times[0]), h - 6);
    const every = Math.max(1, Math.floor(times.length / (2 * w)));
    for (let m = 0; m < times.length; m += every) {
      let value = 0;
      for (let k = m; k < Math.min(m + every, times.length); k++) value = Math.max(value, series[k]);
      stripPen.lineTo(at(times[m]), h - 6 - (value / top) * (h - 20));
    }
    stripPen.lineTo(at(times[times.length - 1]), h - 6);
    stripPen.fillStyle = style.getPropertyValue("--view");
    stripPen.globalAlpha = 0.5;
    stripPen.fill();
    stripPen.globalAlpha = 1;
    for (const [t, kind] of data.events) {
      stripPen.fillStyle = style.getPropertyValue(kind === "doubt" ? "--hidden" : "--muted");
      stripPen.fillRect(at(t) - 1, h - 5, 2, 5);
    }
    stripPen.fillStyle = style.getPropertyValue("--ink");
    stripPen.font = "11px system-ui, sans-serif";
    stripPen.textBaseline = "top";
    stripPen.fillText(compared ? `largest error, up to ${number(top)} ${data.unit}` : `targets, up to ${top}`, 10, 1);
    stripPen.fillRect(at(times[now]) - 1, 0, 2, h);
  };
  strip.addEventListener("pointerdown", (event) => {
    const box = strip.getBoundingClientRect();
    goTo(times[0] + ((event.clientX - box.left - 8) / (box.width - 16)) * span);
  });

  // ---- words
  // As many digits as a place has, rounded to whole steps as it is
  const digits = Math.min(Math.max(Math.floor(-Math.log10(2 * data.step)), 0), 3);
  const number = (value) => (Math.abs(value) >= 1000 ? value.toFixed(0) : value.toPrecision(3));
  const clock = (t) => {
    const whole = Math.floor(t / 60), rest = (t - 60 * whole).toFixed(2).padStart(5, "0");
    return span < 600 ? `${t.toFixed(2)} s` : whole < 60 ? `${whole}:${rest}` : `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}:${rest}`;
  };
  const rowsElement = $("replay-rows"), said = $("replay-said"), tip = $("replay-tip");
  const wordsOf = (person, people, real) => {
    const at = data.same ? real.targets.get(person.target) : undefined;
    const seen = person.seen === null ? "–" : person.seen === "" ? "nobody" : person.seen.split(",").join(", ");
    return [
      String(data.targets[person.target]),
      person.outside ? "outside" : person.at.map((v) => v.toFixed(digits)).join(", "),
      person.known ? number(1.0 * Math.hypot(person.sx, person.sy)) : "–",
      at ? number(Math.hypot(at[0] - person.at[0], at[1] - person.at[1])) : "–",
      person.existence === null ? "–" : person.existence.toFixed(2),
      seen,
      [person.doubt, ...hiders(person, people).map((text) => `hidden by ${text}`)].filter(Boolean).join("; ") || "–",
    ];
  };
  const writeRows = () => {
    const people = peopleAt(now), real = truthAt(now);
    rowsElement.replaceChildren(...people.map((person) => {
      const row = document.createElement("tr");
      wordsOf(person, people, real).forEach((text, k) => {
        const cell = document.createElement(k ? "td" : "th");
        if (!k) {
          cell.scope = "row";
          const dot = document.createElement("span");
          dot.className = `dot t${person.target % 6}`;
          cell.append(dot);
        }
        if (k && k < 5) cell.className = "n";
        cell.append(text);
        row.append(cell);
      });
      return row;
    }));
    $("replay-clock").textContent = clock(times[now]);
    slider.setAttribute("aria-valuetext", clock(times[now]));
    if (!playing) {
      said.textContent = `At ${clock(times[now])}: ${people.length} ${people.length === 1 ? "target" : "targets"}.`;
    }
  };

  // ---- images of the cameras
  const pictures = (data.images || []).map((camera) => {
    const stamps = unpack(camera.times), image = $(`replay-image-${camera.index}`);
    return { stamps, image, camera, at: -1 };
  });
  const showPictures = () => {
    for (const each of pictures) {
      let k = each.stamps.findIndex((t) => t > times[now] + 1e-9);
      k = (k < 0 ? each.stamps.length : k) - 1;
      if (k === each.at) continue;
      each.at = k;
      if (k >= 0) each.image.src = `data:image/jpeg;base64,${each.camera.data[k]}`;
      else each.image.removeAttribute("src");
    }
  };

  // ---- a cursor in each figure over time
  const cursors = [...document.querySelectorAll("figure[data-x0]")].map((figure) => {
    const box = figure.querySelector(".frame"), line = document.createElement("div");
    const value = (name) => Number(figure.dataset[name]);
    line.className = "cursor";
    box.append(line);
    box.addEventListener("pointerdown", (event) => {
      const size = box.querySelector("svg").getBoundingClientRect();
      const share = ((event.clientX - size.left) / size.width - value("x0")) / (value("x1") - value("x0"));
      if (share >= 0 && share <= 1) goTo((value("t0") + share * (value("t1") - value("t0"))) * data.second);
    });
    return () => {
      const svg = box.querySelector("svg");
      const share = (times[now] / data.second - value("t0")) / (value("t1") - value("t0"));
      line.hidden = share < 0 || share > 1;
      line.style.left = `${svg.clientWidth * (value("x0") + share * (value("x1") - value("x0")))}px`;
      line.style.height = `${svg.clientHeight}px`;
    };
  });

  // ---- moving in time
  const slider = $("replay-time"), button = $("replay-play");
  slider.max = String(times.length - 1);
  let planned = 0;
  const show = () => {
    planned = 0;
    slider.value = String(now);
    draw();
    writeRows();
    showPictures();
    cursors.forEach((move) => move());
  };
  const plan = () => {
    if (!planned) planned = requestAnimationFrame(show);
  };
  const set = (m) => {
    now = Math.min(Math.max(m, 0), times.length - 1);
    plan();
  };
  const momentOf = (t) => {
    let a = 0, b = times.length - 1;
    while (a < b) {
      const middle = (a + b + 1) >> 1;
      if (times[middle] <= t + 1e-9) a = middle;
      else b = middle - 1;
    }
    return a;
  };
  const goTo = (t) => set(momentOf(t));
  let began = 0, from = 0;
  const step = (stamp) => {
    if (!playing) return;
    if (!began) {
      began = stamp;
      from = times[now];
    }
    const t = from + ((stamp - began) / 1000) * speed, m = momentOf(t);
    if (m !== now) set(m);
    if (m >= times.length - 1) return play(false);
    requestAnimationFrame(step);
  };
  const play = (on) => {
    playing = on;
    began = 0;
    button.textContent = on ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(on));
    if (on) {
      if (now >= times.length - 1) set(0);
      requestAnimationFrame(step);
    } else plan();
  };
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => {
    began = 0;
    set(Number(slider.value));
  });
  $("replay-speed").addEventListener("change", (event) => {
    speed = Number(event.target.value);
    began = 0;
  });
  root.addEventListener("change", plan);
  root.addEventListener("keydown", (event) => {
    const typing = ["SELECT", "BUTTON", "SUMMARY"].includes(event.target.tagName) || event.target.type === "checkbox";
    if (event.key === " " && !typing) {
      event.preventDefault();
      play(!playing);
    } else if (event.target === canvas || event.target === strip) {
      const moves = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10, Home: -times.length, End: times.length };
      if (event.key in moves) {
        event.preventDefault();
        set(now + moves[event.key]);
      }
    }
  });
  for (const link of document.querySelectorAll("[data-time]")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      goTo(Number(link.dataset.time));
      root.scrollIntoView({ block: "start" });
      canvas.focus({ preventScroll: true });
    });
  }
  for (const box of root.querySelectorAll("[data-target]")) {
    box.addEventListener("change", () => {
      if (box.checked) hiddenTargets.delete(Number(box.dataset.target));
      else hiddenTargets.add(Number(box.dataset.target));
    });
  }
  canvas.addEventListener("pointermove", (event) => {
    const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    const people = peopleAt(now).filter((p) => !hiddenTargets.has(p.target) && !p.outside);
    const near = people.map((p) => [Math.hypot(px(p.at)[0] - x, px(p.at)[1] - y), p]).sort((a, b) => a[0] - b[0])[0];
    const found = near && near[0] < 16 ? near[1] : null;
    tip.hidden = !found;
    if (found) {
      const names = ["target", `x, y [${data.unit}]`, `σ [${data.unit}]`, `error [${data.unit}]`, "existence", "seen by", "remarks"];
      tip.replaceChildren(...wordsOf(found, people, truthAt(now)).map((text, k) => {
        const line = document.createElement("div");
        line.textContent = `${names[k]}: ${text}`;
        return line;
      }));
      tip.style.left = `${Math.min(x + 14, width - tip.offsetWidth)}px`;
      tip.style.top = `${y + 14}px`;
    }
    if ((found && found.target) !== hovered) {
      hovered = found ? found.target : null;
      draw();
    }
  });
  canvas.addEventListener("pointerleave", () => {
    tip.hidden = true;
    hovered = null;
    draw();
  });
  new ResizeObserver(() => {
    fit();
    plan();
  }).observe(canvas.parentElement);
  fit();
  goTo(Number(/^#t=([\d.]+)$/.exec(location.hash)?.[1] ?? times[0]));
})();
