// Two runs in step: a plan of each, one time line, and their values in words.
(() => {
  const source = $("replay-data"), root = $("replay");
  if (!source || !root) return followTheme(() => {});
  const data = JSON.parse(source.textContent);
  root.hidden = false;
  const times = unpack(data.times), apart = unpack(data.apart), alone = unpack(data.alone), partner = unpack(data.partner);
  // True positions are the same in both plans
  data.b.truth = data.a.truth;
  const letters = ["A", "B"], hidden = [new Set(), new Set()];
  const plans = letters.map((letter, k) => (
    makePlan($(`replay-plan-${letter.toLowerCase()}`), data[letter.toLowerCase()], times, hidden[k])
  ));
  const unit = data.a.unit;
  let at = 0;

  const marks = data.changes.map((t) => [t, "t5"]);
  times.forEach((t, m) => alone[m] && marks.push([t, "hidden"]));
  const strip = makeStrip(times, apart, (top) => `largest distance of partners, up to ${number(top)} ${unit}`, marks);

  // ---- words
  // Partners at a time, those of A first; null where a run has no track
  const pairsAt = (m) => {
    const [ofA, ofB] = plans.map((plan) => plan.peopleAt(m)), left = new Map(ofB.map((person) => [person.target, person]));
    const out = ofA.map((person) => {
      const other = left.get(partner[person.row]) || null;
      if (other) left.delete(other.target);
      return [person, other];
    });
    return { ofA, ofB, pairs: [...out, ...[...left.values()].map((person) => [null, person])] };
  };
  const distance = ([a, b]) => (a && b ? number(Math.hypot(a.at[0] - b.at[0], a.at[1] - b.at[1])) : "–");
  const sigma = (person) => (person && person.known ? number(Math.hypot(person.sx, person.sy)) : "–");
  const cells = (pair, all) => {
    const each = (words) => pair.map((person, k) => (person ? words(plans[k], person, k) : "–"));
    return [
      ...each((plan, person) => String(plan.data.targets[person.target])),
      distance(pair),
      ...each((plan, person) => plan.placeWords(person)),
      ...pair.map(sigma),
      ...each((plan, person) => plan.seenWords(person)),
      ...each((plan, person, k) => plan.remarks(person, all[k])),
    ];
  };
  const writeRows = (now, playing) => {
    const { ofA, ofB, pairs } = pairsAt(now);
    $("replay-rows").replaceChildren(...pairs.map((pair) => {
      const row = document.createElement("tr");
      cells(pair, [ofA, ofB]).forEach((text, k) => {
        const cell = document.createElement(k < 2 ? "th" : "td");
        if (k < 2) {
          cell.scope = "row";
          if (pair[k]) cell.append(plans[k].dot(pair[k].target));
        } else if (k < 7) cell.className = "n";
        cell.append(text);
        row.append(cell);
      });
      return row;
    }));
    if (!playing) {
      const most = Math.max(0, ...pairs.filter(([a, b]) => a && b).map(([a, b]) => Math.hypot(a.at[0] - b.at[0], a.at[1] - b.at[1])));
      $("replay-said").textContent = (
        `At ${time.words(times[now])}: ${ofA.length} in A, ${ofB.length} in B, at most ${number(most)} ${unit} apart.`
      );
    }
  };

  // ---- together
  const time = makeTime(root, times, data.second, strip, plans.map((plan) => plan.canvas), (now, playing) => {
    at = now;
    plans.forEach((plan) => plan.draw(now));
    writeRows(now, playing);
  });
  plans.forEach((plan, k) => {
    tellWhatIsThere(plan, $(`replay-tip-${letters[k].toLowerCase()}`), (person) => {
      const { ofA, ofB, pairs } = pairsAt(at);
      const pair = pairs.find((each) => each[k] && each[k].target === person.target);
      const names = ["A", "B", `apart [${unit}]`, "A: x, y", "B: x, y", "A: σ", "B: σ", "A: seen by", "B: seen by", "A: remarks", "B: remarks"];
      return cells(pair, [ofA, ofB]).map((text, n) => `${names[n]}: ${text}`);
    });
  });
  for (const box of root.querySelectorAll("[data-person]")) {
    box.addEventListener("change", () => {
      plans.forEach((plan, k) => plan.data.person.forEach((person, target) => {
        if (person !== Number(box.dataset.person)) return;
        if (box.checked) hidden[k].delete(target);
        else hidden[k].add(target);
      }));
    });
  }
  followTheme(() => time.plan());
  new ResizeObserver(() => {
    plans.forEach((plan) => plan.fit());
    time.plan();
  }).observe($("replay-plans"));
  plans.forEach((plan) => plan.fit());
  time.begin();
})();
