// The time steps of a run: a plan to scrub and play, and its values in words.
(() => {
  const source = $("replay-data"), root = $("replay");
  if (!source || !root) return followTheme(() => {});
  const data = JSON.parse(source.textContent);
  root.hidden = false;
  const times = unpack(data.times), hiddenTargets = new Set();
  const plan = makePlan($("replay-plan"), data, times, hiddenTargets);
  const { tracks, truth, peopleAt, truthAt } = plan;
  let at = 0;

  // ---- the strip: largest error of each time step, or how many are there; events below it
  const series = new Float64Array(times.length);
  const compared = data.compared && truth.first && truth.target.some((t) => t < data.targets.length);
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
  const strip = makeStrip(
    times, series, (top) => (compared ? `largest error at each time step, up to ${number(top)} ${data.unit}` : `targets, up to ${top}`),
    data.events.map(([t, kind]) => [t, kind === "possible_switch" ? "hidden" : "muted"]),
  );

  // ---- words; the table has no columns for what is not known
  const withErrors = Boolean(plan.canvas && data.compared);
  const names = [
    "target", `x, y [${data.unit}]`, `σ [${data.unit}]`, ...(withErrors ? [`error [${data.unit}]`] : []),
    ...(data.existence ? ["existence"] : []), "seen by", "remarks",
  ];
  const wordsOf = (person, people, real) => {
    const at = data.compared ? real.targets.get(person.target) : undefined;
    return [
      String(data.targets[person.target]),
      plan.placeWords(person),
      person.known ? number(1.0 * Math.hypot(person.sx, person.sy)) : "–",
      ...(withErrors ? [at ? number(Math.hypot(at[0] - person.at[0], at[1] - person.at[1])) : "–"] : []),
      ...(data.existence ? [person.existence === null ? "–" : person.existence.toFixed(2)] : []),
      plan.seenWords(person),
      plan.remarks(person, people),
    ];
  };
  const writeRows = (now, playing) => {
    const people = peopleAt(now), real = truthAt(now);
    $("replay-rows").replaceChildren(...people.map((person) => {
      const row = document.createElement("tr");
      wordsOf(person, people, real).forEach((text, k) => {
        const cell = document.createElement(k ? "td" : "th");
        if (!k) {
          cell.scope = "row";
          cell.append(plan.dot(person.target));
        }
        if (k && k < names.length - 2) cell.className = "n";
        cell.append(text);
        row.append(cell);
      });
      return row;
    }));
    if (!playing) {
      $("replay-said").textContent = `At ${time.words(times[now])}: ${people.length} ${people.length === 1 ? "target" : "targets"}.`;
    }
  };

  // ---- images of the cameras
  const pictures = (data.images || []).map((camera) => {
    const stamps = unpack(camera.times), image = $(`replay-image-${camera.index}`);
    return { stamps, image, camera, at: -1 };
  });
  const showPictures = (now) => {
    for (const each of pictures) {
      let k = each.stamps.findIndex((t) => t > times[now] + 1e-9);
      k = (k < 0 ? each.stamps.length : k) - 1;
      if (k === each.at) continue;
      each.at = k;
      if (k >= 0) each.image.src = `data:image/jpeg;base64,${each.camera.data[k]}`;
      else each.image.removeAttribute("src");
    }
  };

  // ---- together
  const time = makeTime(root, times, data.second, strip, [plan.canvas || strip.strip], (now, playing) => {
    at = now;
    plan.draw(now);
    writeRows(now, playing);
    showPictures(now);
  });
  if (plan.canvas) tellWhatIsThere(plan, $("replay-tip"), (person) => (
    wordsOf(person, peopleAt(at), truthAt(at)).map((text, k) => `${names[k]}: ${text}`)
  ));
  switchTargets(root, hiddenTargets);
  followTheme(() => time.plan());
  new ResizeObserver(() => {
    plan.fit();
    time.plan();
  }).observe(plan.canvas ? plan.canvas.parentElement : root);
  plan.fit();
  time.begin();
})();
