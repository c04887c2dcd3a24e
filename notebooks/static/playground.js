// The page playground.md: two robots walk, and saved runs of evaluate are shown.
// The numbers are in playground_results.js, which notebooks/playground.py writes.
"use strict";

window.playground = (() => {
  const DIRECTIONS = [[1, 0], [-1, 0], [0, 1], [0, -1]]; // of row and column
  const LOSS_PER_DISTANCE = 0.2;
  const MAX_STEPS = 200;
  const CELL = 40; // in the units of a grid's picture
  const STEP_MILLISECONDS = 250;
  const SVG = "http://www.w3.org/2000/svg";

  // ---- the gridworld, as oee_tabular.tasks.gridworld makes it

  // Numbers in [0, 1) that depend on the seed alone (mulberry32).
  function makeGenerator(seed) {
    let state = seed >>> 0;
    return () => {
      state = (state + 0x6d2b79f5) >>> 0;
      let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
      mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
      return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
    };
  }

  // The cells of one walk, and its discounted return. Robots of the same seed draw the
  // same numbers, so that only their slips make them differ.
  function walk(world, slip, share, seed, maxSteps = MAX_STEPS) {
    const { size, expert, discount } = world;
    const goal = size * size - 1;
    const draw = makeGenerator(seed);
    const cells = [0];
    let value = 0;
    let factor = 1;
    for (let step = 0; step < maxSteps && cells[step] !== goal; step++) {
      const [isExpert, choice, slipDraw] = [draw(), draw(), draw()];
      let action = isExpert < share ? expert[cells[step]] : Math.floor(4 * choice);
      if (slipDraw < slip) {
        action = (action + 1 + Math.floor((3 * slipDraw) / slip)) % 4;
      }
      const [down, right] = DIRECTIONS[action];
      const keepInside = (place) => Math.min(Math.max(place, 0), size - 1);
      const row = keepInside(Math.floor(cells[step] / size) + down);
      const column = keepInside((cells[step] % size) + right);
      cells.push(row * size + column);
      value -= factor * LOSS_PER_DISTANCE * (2 * (size - 1) - row - column);
      factor *= discount;
    }
    return { cells, value, isAtGoal: cells[cells.length - 1] === goal };
  }

  // ---- what is written

  const write = (number, decimals) =>
    number.toFixed(decimals).replace(/^-(?=0*\.?0*$)/, "").replace("-", "\u2212");

  // Two digits of an interval's width, as reports print it.
  function countDecimals(width) {
    if (!(width > 0)) return 4;
    return Math.min(4, Math.max(0, 1 - Math.floor(Math.log10(width))));
  }

  const percent = (share) => `${Math.round(100 * share)}%`;
  // As pages write numbers: a space from five digits on.
  const count = (number) =>
    number < 10_000 ? `${number}` : number.toLocaleString("en").replace(/,/g, "\u00a0");

  function describeShare(share) {
    if (share === 0) return "0% (uniform)";
    return share === 1 ? "100% (the expert)" : `${percent(share)} (else uniform)`;
  }

  // ---- pictures

  function element(parent, name, attributes, text) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    parent.append(made);
    return made;
  }

  const center = (cell, size) => [
    ((cell % size) + 0.5) * CELL,
    (Math.floor(cell / size) + 0.5) * CELL,
  ];

  function drawGrid(svg, size) {
    const side = size * CELL;
    svg.setAttribute("viewBox", `-1 -1 ${side + 2} ${side + 2}`);
    for (let cell = 0; cell < size * size; cell++) {
      const [x, y] = center(cell, size);
      const isGoal = cell === size * size - 1;
      element(svg, "rect", {
        x: x - CELL / 2, y: y - CELL / 2, width: CELL, height: CELL,
        class: isGoal ? "play-cell play-goal" : "play-cell",
      });
      const label = isGoal ? "goal" : cell === 0 ? "start" : "";
      if (label) element(svg, "text", { x, y: y + CELL / 2 - 4, class: "play-label" }, label);
    }
    const trail = element(svg, "polyline", { class: "play-trail" });
    const robot = element(svg, "circle", { r: CELL / 4, class: "play-robot" });
    return { trail, robot };
  }

  // Round numbers between two ends, some five of them.
  function chooseTicks(low, high) {
    const rough = (high - low) / 5;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
    const ticks = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) ticks.push(k * step);
    return { ticks, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }

  // A line for each log drawn so far, on an axis that all logs of the setting fit on.
  function drawIntervals(svg, setting, drawn, current) {
    const width = Math.max(260, svg.parentElement.clientWidth);
    const height = 12 * setting.logs.length + 34;
    const ends = [setting.truth, setting.believed, ...setting.logs.flat()];
    let [low, high] = [Math.min(...ends), Math.max(...ends)];
    const margin = 0.04 * (high - low) || 1;
    [low, high] = [low - margin, high + margin];
    const place = (value) => 6 + ((width - 12) * (value - low)) / (high - low);
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.style.height = `${height}px`;
    const bottom = height - 26;
    const { ticks, decimals } = chooseTicks(low, high);
    for (const tick of ticks) {
      const x = place(tick);
      element(svg, "line", { x1: x, x2: x, y1: 0, y2: bottom, class: "play-tick" });
      if (x > 13 && x < width - 13) {
        element(svg, "text", { x, y: height - 8, class: "play-label" }, write(tick, decimals));
      }
    }
    for (const [value, kind] of [[setting.believed, "believed"], [setting.truth, "truth"]]) {
      const x = place(value);
      element(svg, "line", { x1: x, x2: x, y1: 0, y2: bottom, class: `play-${kind}` });
    }
    for (const k of drawn) {
      const [value, lower, upper] = setting.logs[k];
      const y = 12 * k + 8;
      const kind = isCovered(setting, k) ? "play-covers" : "play-misses";
      const group = element(svg, "g", {
        class: k === current ? `${kind} play-current` : kind,
      });
      element(group, "line", { x1: place(lower), x2: place(upper), y1: y, y2: y });
      element(group, "circle", { cx: place(value), cy: y, r: 3 });
    }
  }

  // ---- the results

  const ROUNDING = 1e-4; // of the saved numbers

  const isCovered = ({ logs, truth }, k) =>
    logs[k][1] <= truth + ROUNDING && truth <= logs[k][2] + ROUNDING;

  function findSetting(results, { simulator, target, transitions, policy }) {
    return {
      believed: results.values[simulator][policy],
      truth: results.values[target][policy],
      logs: results.logs[simulator][target][transitions][policy],
    };
  }

  // ---- the page

  function start(root, results) {
    const find = (name) => root.querySelector(`#play-${name}`);
    const choice = {};
    const sliders = {
      simulator: [results.slips, percent],
      target: [results.slips, percent],
      transitions: [results.counts, count],
      policy: [results.shares, describeShare],
    };
    const isStill = window.matchMedia("(prefers-reduced-motion: reduce)");
    const robots = {};
    let seed = 0; // of the walks
    let step = 0;
    let timer = null;
    let log = 0;
    let drawn = new Set([0]);

    for (const name of ["simulator", "target"]) {
      robots[name] = { svg: find(`${name}-grid`), text: find(`${name}-walk`) };
      Object.assign(robots[name], drawGrid(robots[name].svg, results.size));
    }

    const lastStep = () =>
      Math.max(...Object.values(robots).map((robot) => robot.path.cells.length - 1));

    function showStep() {
      for (const [name, { svg, text, trail, robot, path }] of Object.entries(robots)) {
        const own = Math.min(step, path.cells.length - 1);
        const points = path.cells.slice(0, own + 1).map((cell) => center(cell, results.size));
        trail.setAttribute("points", points.map((point) => point.join(",")).join(" "));
        const [x, y] = points[own];
        robot.style.transform = `translate(${x}px, ${y}px)`;
        const isOver = own === path.cells.length - 1;
        text.textContent = !isOver
          ? `Step ${own}`
          : `${path.isAtGoal ? "At the goal" : "Stopped"} after ${own} steps. ` +
            `Return: ${write(path.value, 2)}`;
        const row = Math.floor(path.cells[own] / results.size) + 1;
        const column = (path.cells[own] % results.size) + 1;
        svg.setAttribute(
          "aria-label",
          `The ${name}'s robot is in row ${row}, column ${column} of ${results.size}.`,
        );
      }
    }

    function stop() {
      clearInterval(timer);
      timer = null;
      find("walk").textContent = "Walk";
    }

    // Said once, at the end of a walk: a word for each step would be noise.
    function sayEnd() {
      find("walks").textContent = ["simulator", "target"]
        .map((name) => `${name}: ${robots[name].text.textContent}`)
        .join(". ");
    }

    function advance() {
      step = Math.min(step + 1, lastStep());
      showStep();
      if (step === lastStep()) {
        stop();
        sayEnd();
      }
    }

    function restart() {
      stop();
      step = 0;
      find("walks").textContent = "";
      for (const name of ["simulator", "target"]) {
        const share = results.shares[choice.policy];
        robots[name].path = walk(results, results.slips[choice[name]], share, seed);
      }
      showStep();
    }

    function toggleWalk() {
      if (timer !== null) return stop();
      if (step === lastStep()) restart();
      if (isStill.matches) {
        step = lastStep() - 1; // the whole path at once
        return advance();
      }
      find("walk").textContent = "Pause";
      timer = setInterval(advance, STEP_MILLISECONDS);
    }

    function showResults() {
      const setting = findSetting(results, choice);
      const [value, lower, upper] = setting.logs[log];
      const decimals = countDecimals(upper - lower);
      const exact = Math.max(2, decimals + 1);
      const hits = [...drawn].filter((k) => isCovered(setting, k)).length;
      const level = percent(results.confidence);
      const texts = {
        log: `Log ${log + 1} of ${setting.logs.length}`,
        believed: write(setting.believed, exact),
        value: write(value, decimals),
        interval: `${write(lower, decimals)} to ${write(upper, decimals)}`,
        truth: write(setting.truth, exact),
        covers: isCovered(setting, log)
          ? "The interval covers the true value."
          : "The interval misses the true value.",
        count:
          drawn.size === setting.logs.length
            ? `All ${drawn.size} logs are drawn: ${hits} intervals cover.`
            : `So far ${hits} of ${drawn.size} cover.`,
      };
      for (const [name, text] of Object.entries(texts)) {
        if (find(name).textContent !== text) find(name).textContent = text;
      }
      find("covers").className = isCovered(setting, log) ? "" : "play-missed";
      drawIntervals(find("intervals"), setting, drawn, log);
      find("intervals").setAttribute(
        "aria-label",
        `${level} intervals of ${drawn.size} logs; ${hits} cover the true value ${texts.truth}.`,
      );
    }

    function redraw() {
      log = (log + 1) % results.logs[0][0][0][0].length;
      drawn.add(log);
      showResults();
    }

    function drawAll() {
      drawn = new Set(findSetting(results, choice).logs.keys());
      showResults();
    }

    function readSliders() {
      for (const [name, [values, describe]] of Object.entries(sliders)) {
        const slider = find(name);
        choice[name] = Number(slider.value);
        const text = describe(values[choice[name]]);
        slider.setAttribute("aria-valuetext", text);
        find(`${name}-text`).textContent = text;
      }
      log = 0;
      drawn = new Set([0]);
      restart();
      showResults();
    }

    for (const [name, [values]] of Object.entries(sliders)) {
      find(name).max = values.length - 1;
      find(name).value = find(name).dataset.first;
      find(name).addEventListener("input", readSliders);
    }
    const buttons = {
      walk: toggleWalk,
      step: () => {
        stop();
        advance();
      },
      again: () => {
        seed += 1;
        restart();
      },
      redraw,
      all: drawAll,
    };
    for (const [name, act] of Object.entries(buttons)) {
      find(name).addEventListener("click", act);
    }
    new ResizeObserver(showResults).observe(find("intervals").parentElement);
    root.hidden = false;
    readSliders();
  }

  const root = document.querySelector("#playground");
  if (root && window.playgroundResults) {
    start(root, window.playgroundResults);
  } else if (root) {
    root.replaceChildren("The results (playground_results.js) are missing.");
    root.hidden = false;
  }
  return { walk };
})();
