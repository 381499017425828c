// Moving in time: the slider, the strip above it, playing, keys, links, a cursor in each figure; light and dark.

// ---- light and dark: `redraw` after a change
const followTheme = (redraw) => {
  const themes = $("themes");
  if (!themes) return;
  themes.hidden = false;
  themes.addEventListener("change", (event) => {
    const value = event.target.value;
    if (value === "system") document.documentElement.removeAttribute("data-theme");
    else document.documentElement.setAttribute("data-theme", value);
    redraw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
};

// ---- the strip above the slider: a value of each time step as an area, and marks below it
// `words` describe it, with its largest value; `marks` are a time and the name of a colour each
const makeStrip = (times, series, words, marks) => {
  const strip = $("replay-strip"), pen = strip.getContext("2d");
  const top = series.reduce((a, b) => Math.max(a, b), 0) || 1;
  const span = times[times.length - 1] - times[0] || 1;
  const draw = (now) => {
    const style = palette(), ratio = window.devicePixelRatio || 1, w = strip.clientWidth, h = strip.clientHeight;
    if (strip.width !== Math.round(w * ratio)) {
      strip.width = Math.round(w * ratio);
      strip.height = Math.round(h * ratio);
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    const at = (t) => 8 + ((t - times[0]) / span) * (w - 16);
    pen.beginPath();
    pen.moveTo(at(times[0]), h - 6);
    const every = Math.max(1, Math.floor(times.length / (2 * w)));
    for (let m = 0; m < times.length; m += every) {
      let value = 0;
      for (let k = m; k < Math.min(m + every, times.length); k++) value = Math.max(value, series[k]);
      pen.lineTo(at(times[m]), h - 6 - (value / top) * (h - 20));
    }
    pen.lineTo(at(times[times.length - 1]), h - 6);
    pen.fillStyle = style.getPropertyValue("--view");
    pen.globalAlpha = 0.5;
    pen.fill();
    pen.globalAlpha = 1;
    for (const [t, colour] of marks) {
      pen.fillStyle = style.getPropertyValue(`--${colour}`);
      pen.fillRect(at(t) - 1, h - 5, 2, 5);
    }
    pen.fillStyle = style.getPropertyValue("--ink");
    pen.font = "11px system-ui, sans-serif";
    pen.textBaseline = "top";
    pen.fillText(words(top), 10, 1);
    pen.fillRect(at(times[now]) - 1, 0, 2, h);
  };
  const timeAt = (x) => {
    const box = strip.getBoundingClientRect();
    return times[0] + ((x - box.left - 8) / (box.width - 16)) * span;
  };
  return { strip, draw, timeAt };
};

// ---- the time that is shown; `show(now, playing)` draws and writes that time step, `canvases` take keys
const makeTime = (root, times, second, strip, canvases, show) => {
  const slider = $("replay-time"), button = $("replay-play");
  const span = times[times.length - 1] - times[0] || 1;
  let now = 0, playing = false, planned = 0, began = 0, from = 0, speed = 1;
  const words = (t) => {
    const whole = Math.floor(t / 60), rest = (t - 60 * whole).toFixed(2).padStart(5, "0");
    return span < 600 ? `${t.toFixed(2)} s` : whole < 60 ? `${whole}:${rest}` : `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}:${rest}`;
  };

  // A cursor in each figure over time
  const cursors = [...document.querySelectorAll("figure[data-x0]")].map((figure) => {
    const box = figure.querySelector(".frame"), line = document.createElement("div");
    const value = (name) => Number(figure.dataset[name]);
    line.className = "cursor";
    box.append(line);
    box.addEventListener("pointerdown", (event) => {
      const size = box.querySelector("svg").getBoundingClientRect();
      const share = ((event.clientX - size.left) / size.width - value("x0")) / (value("x1") - value("x0"));
      if (share >= 0 && share <= 1) goTo((value("t0") + share * (value("t1") - value("t0"))) * second);
    });
    return () => {
      const svg = box.querySelector("svg");
      const share = (times[now] / second - value("t0")) / (value("t1") - value("t0"));
      line.hidden = share < 0 || share > 1;
      line.style.left = `${svg.clientWidth * (value("x0") + share * (value("x1") - value("x0")))}px`;
      line.style.height = `${svg.clientHeight}px`;
    };
  });

  const showNow = () => {
    planned = 0;
    slider.value = String(now);
    strip.draw(now);
    $("replay-clock").textContent = words(times[now]);
    slider.setAttribute("aria-valuetext", words(times[now]));
    show(now, playing);
    cursors.forEach((move) => move());
  };
  const plan = () => {
    if (!planned) planned = requestAnimationFrame(showNow);
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
  slider.max = String(times.length - 1);
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => {
    began = 0;
    set(Number(slider.value));
  });
  strip.strip.addEventListener("pointerdown", (event) => goTo(strip.timeAt(event.clientX)));
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
    } else if (canvases.includes(event.target) || event.target === strip.strip) {
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
      canvases[0].focus({ preventScroll: true });
    });
  }
  return { plan, goTo, words, begin: () => goTo(Number(/^#t=([\d.]+)$/.exec(location.hash)?.[1] ?? times[0])) };
};

// ---- switches of single targets
const switchTargets = (root, hiddenTargets) => {
  for (const box of root.querySelectorAll("[data-target]")) {
    box.addEventListener("change", () => {
      if (box.checked) hiddenTargets.delete(Number(box.dataset.target));
      else hiddenTargets.add(Number(box.dataset.target));
    });
  }
};

// ---- the description of the target under the pointer: `lines` of it, or of none
const tellWhatIsThere = (plan, tip, lines) => {
  plan.canvas.addEventListener("pointermove", (event) => {
    const box = plan.canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    const found = plan.personAt(x, y);
    tip.hidden = !found;
    if (found) {
      tip.replaceChildren(...lines(found).map((text) => {
        const line = document.createElement("div");
        line.textContent = text;
        return line;
      }));
      tip.style.left = `${plan.canvas.offsetLeft + Math.min(x + 14, plan.width() - tip.offsetWidth)}px`;
      tip.style.top = `${plan.canvas.offsetTop + y + 14}px`;
    }
    plan.hover(found ? found.target : null);
  });
  plan.canvas.addEventListener("pointerleave", () => {
    tip.hidden = true;
    plan.hover(null);
  });
};
