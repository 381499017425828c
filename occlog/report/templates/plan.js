// One floor plan: people, lines of sight and occlusions at a time, and their drawing.
// The data come from an element that holds JSON and is never executed; text is set as text.
"use strict";
const NONE = 65535;
const $ = (id) => document.getElementById(id);
const palette = () => getComputedStyle(document.documentElement);
const shown = (layer) => $(`layer-${layer}`)?.checked;
const turn = (angle) => Math.abs(Math.atan2(Math.sin(angle), Math.cos(angle)));
const rowsOf = (columns, m) => (columns.first ? [columns.first[m], columns.first[m + 1]] : [0, 0]);

// ---- numbers: arrays come as base64 of little-endian values
const KINDS = { f8: Float64Array, u4: Uint32Array, u2: Uint16Array, i2: Int16Array, u1: Uint8Array, i1: Int8Array };
const unpack = ([kind, text, value]) => {
  if (kind === "=") return new Float64Array(text).fill(value);
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new KINDS[kind](bytes.buffer);
};
const unpackTable = (packed) => {
  const out = {};
  for (const [name, value] of Object.entries(packed || {})) out[name] = unpack(value);
  return out;
};
const number = (value) => (Math.abs(value) >= 1000 ? value.toFixed(0) : value.toPrecision(3));

// ---- a plan of a run on a canvas (null: nothing is drawn); `times` are the time steps [s], `hiddenTargets` those that are not drawn
const makePlan = (canvas, data, times, hiddenTargets) => {
  const tracks = unpackTable(data.tracks), truth = unpackTable(data.truth);
  const sight = unpackTable(data.sight), hulls = unpackTable(data.hulls);
  const [low, high] = data.limits;
  const centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const place = (columns, i) => [centre[0] + columns.x[i] * data.step, centre[1] + columns.y[i] * data.step];
  const beyond = (columns, i) => Math.abs(columns.x[i]) >= 32767 || Math.abs(columns.y[i]) >= 32767;
  // Colours are those of the targets' numbers, unless the data name others; -1: of no particular target
  const colourNumber = (index) => (data.colours ? data.colours[index] : index % 6);
  const colourOf = (style, index) => style.getPropertyValue(colourNumber(index) < 0 ? "--muted" : `--t${colourNumber(index)}`).trim();
  const pen = canvas && canvas.getContext("2d");
  let width = 0, height = 0, scale = 1, now = 0, hovered = null;
  const px = ([x, y]) => [(x - low[0]) * scale, (high[1] - y) * scale];

  const fit = () => {
    if (!canvas) return;
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

  // People at a time
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

  // Distance from a sensor to the border of the plan in a direction; without a border ahead a part of its diagonal
  const toBorder = (sensor, angle) => {
    const ahead = [sensor.x, sensor.y].map((p, k) => {
      const along = k ? Math.sin(angle) : Math.cos(angle);
      return Math.abs(along) < 1e-9 ? Infinity : ((along > 0 ? high : low)[k] - p) / along;
    });
    const reach = Math.min(...ahead);
    return reach > 0 && reach < Infinity ? reach : 0.35 * Math.hypot(high[0] - low[0], high[1] - low[1]);
  };

  // The part of the floor that a body hides from a camera: between its two tangents, up to the end of its shadow
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
  // People between a camera and a person that it does not see
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

  const draw = (m = now) => {
    now = m;
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
    // What moves and is not a target: where it is, and the tracker's occluder prior
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
        const reach = at ? Math.hypot(at[0] - sensor.x, at[1] - sensor.y) : toBorder(sensor, angle);
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

  // The person nearest to a position on the canvas [px] that is not far from it
  const personAt = (x, y) => {
    const people = peopleAt(now).filter((p) => !hiddenTargets.has(p.target) && !p.outside);
    const near = people.map((p) => [Math.hypot(px(p.at)[0] - x, px(p.at)[1] - y), p]).sort((a, b) => a[0] - b[0])[0];
    return near && near[0] < 16 ? near[1] : null;
  };
  const hover = (target) => {
    if (target === hovered) return;
    hovered = target;
    draw();
  };
  // As many digits as a position has, rounded to whole steps as it is
  const digits = Math.min(Math.max(Math.floor(-Math.log10(2 * data.step)), 0), 3);
  // ---- the description of a person
  const placeWords = (person) => (person.outside ? "outside" : person.at.map((v) => v.toFixed(digits)).join(", "));
  const seenWords = ({ seen }) => (seen === null ? "–" : seen === "" ? "no camera" : seen.split(",").join(", "));
  const remarks = (person, people) => (
    [(person.doubt || "").replaceAll("_", " "), ...hiders(person, people).map((text) => `hidden by ${text}`)].filter(Boolean).join("; ") || "–"
  );
  const dot = (target) => {
    const out = document.createElement("span"), colour = colourNumber(target);
    out.className = colour < 0 ? "dot" : `dot t${colour}`;
    return out;
  };
  return {
    data, tracks, truth, canvas, fit, draw, peopleAt, truthAt, personAt, hover, placeWords, seenWords, remarks, dot, width: () => width,
  };
};
