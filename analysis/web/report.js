// Fills report.html from the JSON inside it: tables as DOM (names from outside are only ever text), and
// one chart whose tracks share the time axis.
"use strict";

(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const report = data.report;
  const run = report.run;
  const unknown = "unknown";

  // ---- small helpers

  const byId = (id) => document.getElementById(id);
  const body = (id) => byId(id).querySelector(".body");

  function make(tag, properties, ...children) {
    const node = Object.assign(document.createElement(tag), properties);
    node.append(...children);
    return node;
  }

  function show(id, text) {
    const node = byId(id);
    node.hidden = !text;
    node.textContent = text || "";
  }

  const fixed = (value, decimals) => (value === null ? "-" : value.toFixed(decimals));
  const ms = (value) => fixed(value, 3);
  const range = (low, high, decimals) =>
    low === null ? "-" : `${low.toFixed(decimals)} to ${high.toFixed(decimals)}`;
  const note = (text) => make("p", { className: "note" }, text);

  const prefixes = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];

  const prefixOf = (size) => prefixes.find(([least]) => size >= 0.9995 * least) || prefixes[prefixes.length - 1];

  // Of three digits in all, those behind the point of a number from 1 to 999.
  const decimalsOf = (size) => (size >= 99.95 ? 0 : size >= 9.995 ? 1 : 2);

  // Three digits and a prefix: scaled(0.0031, "s") is "3.10 ms".
  function scaled(value, unit) {
    const size = Math.abs(value);
    if (size === 0 || unit === "°C" || unit === "%") return `${+value.toPrecision(3)} ${unit}`;
    const [factor, prefix] = prefixOf(size);
    return `${(value / factor).toFixed(decimalsOf(size / factor))} ${prefix}${unit}`;
  }

  // Without trailing zeros, for axes.
  const axisMs = (value) => {
    if (value === 0) return "0";
    const [factor, prefix] = value >= 1000 ? [1, ""] : prefixOf(Math.abs(value) * 1e-3);
    return `${+(value * 1e-3 / factor).toPrecision(3)} ${prefix}s`;
  };
  const axisNumber = (value) => {
    if (Math.abs(value) < 1e5) return value.toLocaleString("en", { maximumSignificantDigits: 6 });
    const [factor, prefix] = prefixOf(Math.abs(value));
    return `${+(value / factor).toPrecision(3)} ${prefix}`;
  };
  const scaledMs = (value) => scaled(value * 1e-3, "s");
  const percent = (ratio) => (ratio === null ? "-" : `${+(100 * ratio).toPrecision(3)} %`);

  // A value and below it what it is uncertain by.
  const withRange = (value, between) => make("span", {}, value, ...(between ? [make("small", {}, between)] : []));

  // [value, interval] with one prefix for all.
  function estimated({ value, low, high }, factor, unit) {
    if (value === null) return ["-", ""];
    const [scale, prefix] = prefixOf(factor * Math.max(Math.abs(value), Math.abs(low), Math.abs(high)));
    const numbers = [value, low, high].map((number) => (number * factor) / scale);
    const decimals = decimalsOf(Math.max(...numbers.map(Math.abs)));
    const [middle, from, to] = numbers.map((number) => number.toFixed(decimals));
    return [`${middle} ${prefix}${unit}`, `${from} to ${to}`];
  }
  const estimate = (value, factor, unit) => withRange(...estimated(value, factor, unit));
  const estimateText = (value, factor, unit) => {
    const [text, between] = estimated(value, factor, unit);
    return between ? `${text} (${between})` : text;
  };
  const plural = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

  // columns: {title, unit, right, header, wide, value(row), tone(row)}; value gives text or a node.
  function table(caption, columns, rows) {
    const head = make("tr");
    for (const column of columns) {
      const cell = make("th", { scope: "col", className: column.right ? "right" : "" }, column.title);
      if (column.unit) cell.append(make("small", {}, column.unit));
      head.append(cell);
    }
    const lines = rows.map((row) => {
      const line = make("tr");
      for (const column of columns) {
        const classes = [column.right && "right", column.wide && "wide", column.tone && column.tone(row)];
        const cell = make(column.header ? "th" : "td", { className: classes.filter(Boolean).join(" ") });
        if (column.header) cell.scope = "row";
        cell.append(column.value(row));
        line.append(cell);
      }
      return line;
    });
    const grid = make("table", {}, make("caption", {}, make("span", {}, caption)), make("thead", {}, head),
      make("tbody", {}, ...lines));
    const scroll = make("div", { className: "scroll", tabIndex: 0 }, grid);
    scroll.setAttribute("role", "region");
    scroll.setAttribute("aria-label", caption);
    return scroll;
  }

  function list(lines) {
    return make("ul", {}, ...lines.map((line) => make("li", {}, line)));
  }

  // ---- colours: those of "Color Universal Design", by M. Okabe and K. Ito, 2008, darkened or lightened
  // to stand out from the ground

  const palettes = {
    light: ["#0072b2", "#c4500a", "#00855f", "#a9508a", "#8a6a00", "#2f8fc4", "#6b5bb5", "#5d6670"],
    dark: ["#5aaee8", "#f08c4a", "#3fc79a", "#e39ccb", "#e2c044", "#8fd0f5", "#b0a3f0", "#b4bec8"],
  };
  // Of causes, in the order of data.causes; the shape tells them apart without colours.
  const causeColors = {
    light: ["#c01f2e", "#c4500a", "#8a6a00", "#0072b2", "#6b5bb5", "#00855f", "#5d6670"],
    dark: ["#ff8a8a", "#f0a04a", "#e2c044", "#5aaee8", "#b0a3f0", "#3fc79a", "#b4bec8"],
  };
  const causeSymbols = ["triangle", "rect", "diamond",
    "path://M-1,-3h2v2h2v2h-2v2h-2v-2h-2v-2h2z", "path://M-3,-2L-2,-3L0,-1L2,-3L3,-2L1,0L3,2L2,3L0,1L-2,3L-3,2L-1,0z",
    "path://M-3,-3L3,-3L0,3z", "circle"];
  const causeGlyphs = ["\u25b2", "\u25a0", "\u25c6", "\u271a", "\u2716", "\u25bc", "\u25cf"];
  const bandColors = {
    light: { power: "#c4500a", thermal: "#c01f2e", other: "#8a6a00" },
    dark: { power: "#f0a04a", thermal: "#ff8a8a", other: "#e2c044" },
  };
  const darkQuery = window.matchMedia("(prefers-color-scheme: dark)");
  let printing = false;
  const theme = () => (darkQuery.matches && !printing ? "dark" : "light");
  const palette = () => palettes[theme()];
  const causeColor = (cause) => causeColors[theme()][cause];
  const bandColor = (name) =>
    bandColors[theme()][name.startsWith("power") ? "power" : name === "thermal" ? "thermal" : "other"];
  const algorithms = [...new Set(report.cells.map((cell) => cell.algorithm))];
  const colorOf = (algorithm) => palette()[algorithms.indexOf(algorithm) % palette().length];

  function key(algorithm) {
    const mark = make("span", { className: "key" });
    mark.dataset.algorithm = algorithm;
    return mark;
  }

  function paintKeys() {
    for (const node of document.querySelectorAll("[data-algorithm]"))
      node.style.background = colorOf(node.dataset.algorithm);
    for (const node of document.querySelectorAll("[data-cause]"))
      node.style.color = causeColor(Number(node.dataset.cause));
  }

  function named(algorithm) {
    const text = make("span", { className: "named" });
    text.append(key(algorithm), algorithm);
    return text;
  }

  function causeNamed(cause) {
    const mark = make("span", { className: "glyph", ariaHidden: "true" }, causeGlyphs[cause]);
    mark.dataset.cause = cause;
    return make("span", { className: "named" }, mark, data.causes[cause]);
  }

  // ---- frames and outliers, packed by report_html.cpp

  function reader(text) {
    const bytes = atob(text);
    let at = 0;
    return () => {
      let number = 0;
      let place = 1;
      let byte = 128;
      for (; byte > 127; place *= 128) {
        byte = bytes.charCodeAt(at++);
        number += (byte & 127) * place;
      }
      return number % 2 === 1 ? -(number + 1) / 2 : number / 2;
    };
  }

  const outliers = { cell: [], frame: [], t_s: [], ms: [], excess_ms: [], cause: [], is_stretch: [], confidence_pct: [] };

  // Points of a cell: [seconds, ms, frame, number of the outlier or undefined]; null between trials.
  function unpack({ unit_ms, count, points: text }, cell) {
    const next = reader(text);
    const found = [];
    let [t, frame, level] = [0, 0, 0];
    for (let i = 0; i < count; ++i) {
      const head = next();
      t += next();
      frame += next();
      level += next();
      if (head % 2 === 1 && found.length > 0) found.push(null);
      const what = Math.floor(head / 2) - 1;
      const at = +(t * 1e-5).toFixed(5);
      if (what < 0) {
        found.push([at, +(level * unit_ms).toPrecision(6), frame]);
        continue;
      }
      const excess = next();
      const time = +((level + excess) * unit_ms).toPrecision(6);
      found.push([at, time, frame, outliers.ms.length]);
      const values = { cell, frame, t_s: at, ms: time, excess_ms: +(excess * unit_ms).toPrecision(6),
        cause: Math.floor(what / 2), is_stretch: what % 2, confidence_pct: next() };
      for (const [name, value] of Object.entries(values)) outliers[name].push(value);
    }
    return found;
  }

  const points = data.frames.map(unpack);
  const drawnCount = outliers.ms.length;
  const outlierCount = data.outlier_count;
  const byTime = [...outliers.t_s.keys()].sort((a, b) => outliers.t_s[a] - outliers.t_s[b]);
  const ratioOf = (index) => +(outliers.ms[index] / (outliers.ms[index] - outliers.excess_ms[index])).toFixed(2);

  // Rounding must not turn much into certainty.
  const confidenceText = (value) => (value >= 0.995 ? "> 0.99" : value > 0 && value < 0.005 ? "< 0.01" : value.toFixed(2));
  const confidence = (index) => confidenceText(outliers.confidence_pct[index] / 100);

  function evidenceValue(value, unit) {
    if (unit === "1") return `${+(100 * value).toFixed(0)} %`;
    if (unit === "%" || unit === "s/s") return `${+value.toPrecision(3)} ${unit}`;
    if (unit.startsWith("count"))
      return (Math.abs(value) < 999.5 ? String(+value.toPrecision(3)) : scaled(value, "").trim()) + unit.slice(5);
    return scaled(value, unit);
  }

  function evidenceLines(index) {
    const seen = data.evidence.of[index];
    if (seen === undefined) return ["in report.json"];
    if (seen.length === 0) return ["none: no channel told it from a normal frame"];
    return seen.map(([channel, unit, value, expected]) => {
      const name = data.evidence.units[unit];
      const flag = name === "1";
      const said = flag ? (value === 0 ? "not set" : `set ${evidenceValue(value, name)} of the time`) : evidenceValue(value, name);
      const usual = expected === null ? "" : evidenceValue(expected, name);
      return `${data.evidence.channels[channel]} ${said}`
        + (expected === null ? "" : usual === evidenceValue(value, name) ? ", as usual" : ` instead of ${usual}`);
    });
  }

  function outlierText(index) {
    const cell = report.cells[outliers.cell[index]];
    return `Outlier at ${outliers.t_s[index].toFixed(3)} s: ${cell.algorithm}, `
      + `${cell.model}, view ${cell.view}, frame ${outliers.frame[index]}, ${scaledMs(outliers.ms[index])}, `
      + `${ratioOf(index)} times its fast regime. Cause: ${data.causes[outliers.cause[index]]}, `
      + `confidence ${confidence(index)}. Evidence: ${evidenceLines(index).join("; ")}.`;
  }

  // ---- top of the page

  function fillTop() {
    show("question", run.question);
    show("verdict", run.verdict);
    for (const flag of run.flags)
      byId("flags").append(
        make("p", { className: "flag" }, make("strong", {}, flag.label), flag.text));
    const host = run.host || {};
    const device = report.device;
    const facts = {
      ...(run.command
        ? { command: run.command.text }
        : { device: device.name, "device type": device.type, driver: run.driver || device.driver }),
      CPU: host.cpu,
      kernel: host.kernel,
      begin: run.begin_utc,
      duration: data.duration,
      recorded: `${run.trials} trials, ${run.frames} frames, ${report.sensors.length} channels`,
      "energyprof": [run.code_version, run.build_type].filter(Boolean).join(", "),
    };
    for (const [name, value] of Object.entries(facts))
      byId("facts").append(
        make("div", {}, make("dt", {}, name), make("dd", {}, String(value || unknown))));
    byId("version").textContent = run.code_version || "";
    byId("score_text").textContent = data.score_text;
  }

  // ---- tables

  function bar(row, longest) {
    const percent = (value) => `${(100 * value) / longest}%`;
    const length = make("span", { className: "length" });
    length.dataset.algorithm = row.algorithm;
    length.style.width = percent(row.normalized);
    const whisker = make("span", { className: "range" });
    whisker.style.left = percent(row.normalized_low);
    whisker.style.width = percent(row.normalized_high - row.normalized_low);
    return make("div", { className: "bar" }, length, ...(row.rank === 1 ? [] : [whisker]));
  }

  function fillRanking() {
    if (report.ranking.length === 0) {
      body("ranking").append(note(report.cells.length > 0 ? "Nothing to rank; the warnings say why." : "No timed frame was recorded."));
      return;
    }
    const longest = Math.max(...report.ranking.map((row) => Math.max(row.normalized, row.normalized_high)));
    const columns = [
      { title: "Rank", right: true, value: (row) => String(row.rank) },
      { title: "Algorithm", header: true, value: (row) => named(row.algorithm) },
      { title: "Score", unit: "ms, 95 %", right: true,
        value: (row) => withRange(ms(row.score_ms), range(row.score_low_ms, row.score_high_ms, 3)) },
      { title: "Normalized", unit: "95 %", right: true, value: (row) => withRange(fixed(row.normalized, 3),
        row.rank === 1 ? "" : range(row.normalized_low, row.normalized_high, 3)) },
      { title: "Times the best", value: (row) => bar(row, longest) },
      { title: "Net energy", unit: "per ray, 95 %", right: true,
        value: (row) => withRange(...data.ranking_energy[report.ranking.indexOf(row)].replace(")", "").split(" (")) },
      { title: "Truncated mean", unit: "ms", right: true, value: (row) => ms(row.truncated_mean_ms) },
      { title: "Std. deviation", unit: "ms", right: true, value: (row) => ms(row.stddev_ms) },
    ];
    const cells = report.ranking[0].cells;
    body("ranking").append(
      table(`Lower is better. Averaged over ${cells} ${cells === 1 ? "model and view" : "models and views"}.`,
        columns, report.ranking),
      note(data.score_text));
  }

  const checksum = (cell) =>
    cell.checksums_agree === null ? "-" : cell.checksums_agree ? "agree" : "differ";

  function fillCells() {
    if (report.cells.length === 0) {
      for (const id of ["cells", "work"]) body(id).append(note("No timed frame was recorded."));
      return;
    }
    body("cells").append(table("One row per model, view and algorithm; timed frames only.", [
      { title: "Model", header: true, value: (cell) => cell.model },
      { title: "View", right: true, value: (cell) => String(cell.view) },
      { title: "Algorithm", value: (cell) => named(cell.algorithm) },
      { title: "Frames", right: true, value: (cell) => String(cell.frames) },
      { title: "Median", unit: "ms, 95 %", right: true, value: (cell) => withRange(ms(cell.median_ms),
        cell.median_low_ms === null ? "" : range(cell.median_low_ms, cell.median_high_ms, 3)) },
      { title: "Truncated mean", unit: "std. deviation, ms", right: true,
        value: (cell) => withRange(ms(cell.truncated_mean_ms), ms(cell.stddev_ms)) },
      { title: "Outliers", right: true, value: (cell) => String(cell.outlier_count),
        tone: (cell) => (cell.outlier_count > 0 ? "bad" : "") },
      { title: "Mrays/s", right: true, value: (cell) => fixed(cell.mrays_per_s, 2) },
      { title: "Rays", unit: "per frame, hits", right: true, value: (cell) => (cell.rays_per_frame === null ? "-"
        : withRange(Math.round(cell.rays_per_frame).toLocaleString("en"), cell.hit_ratio === null ? "" : `${fixed(100 * cell.hit_ratio, 1)} %`)) },
      { title: "Checksums", unit: "of hits", value: checksum,
        tone: (cell) => ({ agree: "good", differ: "bad" })[checksum(cell)] },
      { title: "Clock error", unit: "± µs", right: true, value: (cell) => fixed(cell.clock_error_us, 1) },
    ], report.cells));
    fillWork();
    fillStructures();
  }

  function fillWork() {
    if (!report.cells.some((cell) => Object.values(cell.work).some((value) => value !== null))) {
      body("work").append(note("No frame counted its work."));
      return;
    }
    const perRay = (title, name, decimals, unit) => ({ title, unit, right: true,
      value: (cell) => fixed(cell.work[name], decimals) });
    body("work").append(table("From one counted frame for each model, view and algorithm.", [
      { title: "Model", header: true, value: (cell) => cell.model },
      { title: "View", right: true, value: (cell) => String(cell.view) },
      { title: "Algorithm", value: (cell) => named(cell.algorithm) },
      perRay("Nodes", "node_visits_per_ray", 1),
      perRay("Boxes", "box_tests_per_ray", 1),
      perRay("Triangles", "prim_tests_per_ray", 1),
      perRay("Loop steps", "loop_steps_per_ray", 1),
      perRay("SIMD efficiency", "simd_efficiency", 3),
      perRay("L1 misses", "l1_misses_per_ray_modelled", 2, "modelled"),
      perRay("LLC misses", "llc_misses_per_ray_modelled", 3, "modelled"),
      perRay("Bytes per pixel", "bytes_per_pixel_modelled", 0, "modelled"),
    ], report.cells));
    if (data.cache_text) body("work").append(note(data.cache_text));
  }

  function fillOutliers() {
    const out = body("outliers");
    if (report.cells.length === 0) out.append(note("No timed frame was recorded."));
    else if (outlierCount === 0) out.append(note("No outliers: no timed frame was slow for its trial."));
    else {
      const total = data.cause_rows.reduce((sum, row) => sum + row.excess, 0);
      out.append(table(`What made ${plural(outlierCount, "frame")} slow.`, [
        { title: "Cause", header: true, value: (row) => causeNamed(row.cause) },
        { title: "Outliers", right: true, value: (row) => String(row.count) },
        { title: "Share", right: true, value: (row) => percent(row.count / outlierCount) },
        { title: "Time lost", right: true, value: (row) => scaledMs(row.excess) },
        { title: "Share of it", right: true, value: (row) => percent(total > 0 ? row.excess / total : 0) },
        { title: "Mean confidence", right: true, value: (row) => confidenceText(row.confidence / row.count) },
      ], [...data.cause_rows].sort((a, b) => b.excess - a.excess)));
      const worst = [...outliers.ms.keys()].sort((a, b) => outliers.excess_ms[b] - outliers.excess_ms[a]);
      const shown = worst.slice(0, 12);
      const cellOf = (index) => report.cells[outliers.cell[index]];
      out.append(make("h3", {}, "Those that lost most time"), table(
        worst.length > shown.length ? `${shown.length} of ${worst.length}; all are in report.json.`
          : `All ${worst.length}.`, [
          { title: "Frame", header: true, right: true, value: (i) => String(outliers.frame[i]) },
          { title: "Model, view", value: (i) => make("span", { className: "named" }, `${cellOf(i).model}, ${cellOf(i).view}`) },
          { title: "Algorithm", value: (i) => named(cellOf(i).algorithm) },
          { title: "At", unit: "s", right: true, value: (i) => fixed(outliers.t_s[i], 3) },
          { title: "Time", unit: "ms", right: true, value: (i) => String(+outliers.ms[i].toPrecision(5)) },
          { title: "Ratio", right: true, value: (i) => fixed(ratioOf(i), 2) },
          { title: "Excess", unit: "ms", right: true, value: (i) => String(+outliers.excess_ms[i].toPrecision(4)) },
          { title: "Cause", unit: "confidence, shape", value: (i) => make("div", {}, causeNamed(outliers.cause[i]),
            make("small", {}, `${confidence(i)}, ${outliers.is_stretch[i] ? "stretch" : "spike"}`)) },
          { title: "Evidence", unit: "what decided; where unexplained, what spoke against causes", value: (i) => make("div", { className: "evidence" }, ...evidenceLines(i).map((text) => make("div", {}, text))) },
        ], shown));
    }
    if (report.regimes.length > 0)
      out.append(make("h3", {}, "Trials that drifted or were slow throughout"), table(
        `${report.regimes.length} of ${plural(report.regime_count, "such trial")}.`, [
          { title: "Trial", header: true, right: true, value: (row) => String(row.trial_id) },
          { title: "Frames", right: true, value: (row) => String(row.frames) },
          { title: "Fast regime", unit: "ms", right: true, value: (row) => ms(row.baseline_ms) },
          { title: "Drift", right: true, value: (row) => percent(row.drift_ratio - 1) },
          { title: "Slow throughout", value: (row) => (row.entirely_slow ? "yes" : "no") },
        ], report.regimes));
    if (report.cells.length === 0) return;
    out.append(make("h3", {}, "Throttling"));
    if (report.throttling.sources.length === 0)
      out.append(note("No channel tells of throttling, and no clock from which it could be inferred."));
    else
      out.append(table("What tells of throttling, and how much of the timed frames' time it was set.", [
        { title: "Channel", header: true, value: (row) => row.channel },
        { title: "Class", value: (row) => row.class },
        { title: "Told by", value: (row) => (row.inferred ? "inferred from the clock" : "a reason channel") },
        { title: "Intervals", right: true, value: (row) => String(row.intervals) },
        { title: "Exposure", right: true, value: (row) => percent(row.exposure_ratio) },
        { title: "Seen", unit: "share of the time", right: true, value: (row) => percent(row.coverage_ratio) },
        { title: "Read every", right: true, value: (row) => scaled(row.poll_ns * 1e-9, "s") },
        { title: "Regime", value: (row) => (row.regime ? "yes: explains no single frame" : "no") },
      ], report.throttling.sources));
  }

  // ---- what goes together

  function fillCoincidence() {
    const out = body("relations");
    const found = report.coincidence;
    if (!found) {
      out.append(note("No timed frame was recorded, so nothing can be compared."));
      return;
    }
    out.append(make("h3", {}, "Outliers and throttling"));
    out.append(make("p", { className: "verdict" }, `${found.verdict}.`));
    if (found.frames === 0) return;
    const normal = found.throttled - found.throttled_outliers;
    const rows = [
      { name: "outliers", hit: found.throttled_outliers, rest: found.outliers - found.throttled_outliers },
      { name: "other frames", hit: normal, rest: found.frames - found.outliers - normal },
    ];
    const odds = found.odds_ratio;
    const oddsText = odds.value === null ? "Odds ratio: not told."
      : `Odds ratio ${odds.value.toPrecision(3)} (95 %: ${odds.low.toPrecision(3)} to `
        + `${odds.high === null ? "no bound" : odds.high.toPrecision(3)}).`;
    const p = (value) => (value === null ? "not told" : value.toPrecision(2));
    out.append(table(`${found.frames} frames that a throttle sensor saw.`, [
      { title: "Frames", header: true, value: (row) => row.name },
      { title: "Throttled", right: true, value: (row) => String(row.hit) },
      { title: "Not throttled", right: true, value: (row) => String(row.rest) },
      { title: "Share throttled", right: true,
        value: (row) => percent(row.hit + row.rest > 0 ? row.hit / (row.hit + row.rest) : null) },
    ], rows), note(`${oddsText} ${found.p === null ? "" : `p ${p(found.p)} by circular shifts, ${p(found.p_fisher)} if `
      + `frames were independent; q ${p(found.q)}. `}Of all these frames ${percent(found.exposure_ratio)} were throttled.`));
  }

  function correlationTable(caption, rows) {
    const value = (number) => (number === null ? "-" : number.toPrecision(2));
    return table(caption, [
      { title: "Channel", header: true, value: (row) => row.y },
      { title: "With", unit: "method", value: (row) => withRange(row.x === "frame_ms" ? "frame time" : row.x, row.method) },
      { title: "Coefficient", unit: "95 %", right: true,
        value: (row) => withRange(fixed(row.coefficient, 2), row.low === null ? "" : range(row.low, row.high, 2)) },
      { title: "Lag", unit: "ms", right: true, value: (row) => fixed(row.lag_ms, 1) },
      { title: "q", unit: "p", right: true, value: (row) => withRange(value(row.q), value(row.p)) },
      { title: "Frames", right: true, value: (row) => String(row.n) },
      { title: "Verdict", wide: true, value: (row) => row.verdict },
    ], rows);
  }

  const strength = (row) => Math.abs(row.coefficient || 0);

  function fillRelations() {
    fillCoincidence();
    if (!report.coincidence) return;
    const out = body("relations");
    out.append(make("h3", {}, "Channels"));
    if (report.correlations.length === 0) {
      out.append(note("No channel was recorded that could be compared."));
      return;
    }
    const kinds = { related: [], "not related": [], "cannot tell": [] };
    // Without a lag a lagged row says what the row without lags says.
    for (const row of report.correlations)
      if (row.lag_ms !== 0) kinds[row.verdict.split(":")[0]].push(row);
    for (const rows of Object.values(kinds)) rows.sort((a, b) => strength(b) - strength(a));
    if (kinds.related.length > 0)
      out.append(correlationTable("Related to frame times or outliers, the strongest first.", kinds.related));
    else out.append(note("No channel is related to frame times or outliers beyond doubt."));
    for (const [kind, title] of [["not related", "Not related"], ["cannot tell", "Cannot tell"]])
      if (kinds[kind].length > 0)
        out.append(make("details", {}, make("summary", {}, `${title}: ${kinds[kind].length}, with the reasons`),
          correlationTable(`${title}.`, kinds[kind])));
  }

  function fillFactors() {
    const out = body("factors");
    const model = report.factor_model;
    if (model.explained_time_ratio !== null) {
      const shared = (row, name) => (row[`share_of_${name}_variance`] === null ? "-"
        : percent(row[`share_of_${name}_variance`])
          + (row[`share_of_${name}_low`] === null ? ""
            : ` (${percent(row[`share_of_${name}_low`])} to ${percent(row[`share_of_${name}_high`])})`));
      out.append(table(`Shares of the variance of log time and log energy per ray across ${plural(model.cells, "cell")}, 95 %.`, [
        { title: "Factor", header: true, value: (row) => row.name },
        { title: "Of time", right: true, value: (row) => shared(row, "time") },
        { title: "Of energy", right: true, value: (row) => shared(row, "energy") },
        { title: "Variance inflation", right: true, value: (row) => fixed(row.variance_inflation, 1) },
        { title: "Note", wide: true, value: (row) => row.note || "" },
      ], report.factors));
      out.append(note(`Explained together: ${percent(model.explained_time_ratio)} of time`
        + (model.explained_energy_ratio === null ? "." : `, ${percent(model.explained_energy_ratio)} of energy.`)));
    } else if (model.notes.length === 0) out.append(note("There are too few models, views and algorithms to tell factors apart."));
    const said = (text) => model.explained_time_ratio !== null
      && report.factors.some((row) => row.note && text.includes(row.note));
    const notes = model.notes.filter((text) => !said(text));
    if (notes.length > 0) out.append(list(notes));
  }

  function fillStructures() {
    if (report.structures.length === 0) return;
    const whole = (value) => (value === null ? "-" : value.toLocaleString("en"));
    body("work").append(make("h3", {}, "Structures"), table("What was traversed, as it was built.", [
      { title: "Model", header: true, value: (row) => row.model },
      { title: "Algorithm", value: (row) => named(row.algorithm) },
      { title: "Build", unit: "ms", right: true,
        value: (row) => fixed(row.build_ms, 1) + (row.cached ? " (cached)" : "") },
      { title: "Size", unit: "MiB", right: true, value: (row) => fixed(row.blob_mib, 2) },
      { title: "Triangles", right: true, value: (row) => whole(row.triangle_count) },
      { title: "Nodes", right: true, value: (row) => whole(row.node_count) },
      { title: "Leaves", right: true, value: (row) => whole(row.leaf_count) },
      { title: "References", right: true, value: (row) => whole(row.ref_count) },
      { title: "Depth", right: true, value: (row) => whole(row.max_depth) },
      { title: "SAH cost", right: true, value: (row) => fixed(row.sah_cost, 2) },
    ], report.structures));
    if (report.structures.some((row) => row.cached))
      body("work").append(note("Cached: read from disk; the time is that of its build."));
  }

  const energyTable = (caption, rows) => table(caption, [
    { title: "Model", header: true, value: (row) => row.model },
    { title: "Algorithm", value: (row) => named(row.algorithm) },
    { title: "Frames", right: true, value: (row) => String(row.frames) },
    { title: "Net", unit: "per ray, 95 %", right: true, value: (row) => estimate(row.nj_per_ray, 1e-9, "J") },
    { title: "Net", unit: "per frame, 95 %", right: true, value: (row) => estimate(row.joules_per_frame, 1, "J") },
    { title: "Gross", unit: "per frame, 95 %", right: true, value: (row) => estimate(row.gross_joules_per_frame, 1, "J") },
    { title: "EDP", unit: "mJ s", right: true, value: (row) => (row.edp_js === null ? "-" : (1e3 * row.edp_js).toPrecision(3)) },
    { title: "Idle", unit: "W", right: true, value: (row) => fixed(row.idle_w, 2) },
    { title: "Above idle", unit: "W", right: true, value: (row) => fixed(row.watts_above_idle, 2) },
    { title: "Method", wide: true, value: (row) => (row.refused ? `refused: ${row.refused}` : row.method) },
  ], rows);

  function fillEnergy() {
    const out = body("energy");
    byId("pareto").hidden = paretoPoints().length === 0;
    if (report.energy.length === 0) {
      out.append(note("No timed frame was recorded, so there is no energy per frame."));
      return;
    }
    const refused = [...new Set(report.energy.map((row) => row.refused).filter(Boolean))];
    if (report.energy.every((row) => row.refused))
      out.append(note(`No energy per frame is given, because ${refused.join("; ")}.`));
    else
      out.append(note(`${data.energy_text} Named and joined by a dashed line: what no other algorithm beats in both time and energy. Bars: 95 %. `
        + `${modelsOf(paretoPoints()).map((model, i, all) => `${model}: ${shapeOf(model, all)[1]}`).join("; ")}.`),
        energyTable("Energy of a frame and of a ray.", report.energy));
    if (report.energy_by_channel.length <= report.energy.length) return;
    out.append(make("h3", {}, "Every energy channel"),
      note("Side by side. Some domains contain others (the platform the package, the package its cores and its GPU): they are never summed."));
    for (const channel of new Set(report.energy_by_channel.map((row) => row.channel))) {
      const rows = report.energy_by_channel.filter((row) => row.channel === channel);
      const title = `${channel || "no channel"}${rows[0].domain ? `, ${rows[0].domain}` : ""}`;
      out.append(make("details", {}, make("summary", {}, title), energyTable(`Energy on ${title}.`, rows)));
    }
  }

  const hrefOf = (file) => file.split("/").map(encodeURIComponent).join("/");
  const linked = (files) => make("ul", {}, ...files.map((file) =>
    make("li", {}, make("a", { href: hrefOf(file) }, file))));

  function picture(image, caption) {
    return make("figure", {}, make("a", { href: hrefOf(image.file) },
      make("img", { src: image.src, alt: `${caption} of ${image.place || image.title}` })),
    make("figcaption", {}, caption));
  }

  function fillImages() {
    const out = body("images");
    const places = new Map();
    for (const image of data.images) {
      const place = image.place || "Other images";
      if (!places.has(place)) places.set(place, []);
      places.get(place).push(image);
    }
    if (data.images.length === 0 && data.named_images.length === 0) out.append(note("The run has no images."));
    if (data.images.some((image) => image.place && image.what !== "reference"))
      out.append(note("Heat maps: cost per pixel = 0.5 per box test + 1 per triangle test of the primary ray."));
    if (data.images.length > 0)
      out.append(note(`Here in 64 colours and at most ${data.image_width} pixels wide; each leads to its file in images/, which is whole.`));
    for (const [place, images] of places)
      out.append(make("h3", {}, place), make("div", { className: "pictures" },
        ...images.map((image) => picture(image, image.what
          ? (image.what === "reference" ? "Reference image" : `${image.what}, heat map`) : image.title))));
    if (data.images_left_out.length > 0)
      out.append(note(`Even at this size ${plural(data.images_left_out.length, "more image")} would make the page larger than 3 MB; beside it:`),
        linked(data.images_left_out));
    if (data.named_images.length > 0) out.append(note("Beside this page:"), linked(data.named_images));
  }

  // A recorded program has no frames; a study's sensors are drawn and listed below its results.
  function chooseSections() {
    const hidden = run.command ? ["ranking", "outliers", "relations", "scatter", "factors", "theory", "cells", "work", "energy", "images"] : ["readings"];
    for (const id of hidden) {
      byId(id).hidden = true;
      for (const link of document.querySelectorAll(`nav a[href="#${id}"]`)) link.hidden = true;
    }
  }

  function fillReadings() {
    if (data.readings.length === 0) body("readings").append(note("No sensor delivered samples."));
    else
      body("readings").append(table("Over the whole run.", [
        { title: "Quantity", value: (row) => row.quantity },
        { title: "Channel", header: true, value: (row) => row.channel },
        { title: "Min / mean / max", wide: true, value: (row) => row.text },
      ], data.readings));
  }

  function fillSensors() {
    if (data.sensor_rows.length === 0) {
      body("sensors").append(note("No sensor was recorded."));
      return;
    }
    body("sensors").append(table("What was sampled beside the frames.", [
      { title: "Channel", unit: "where it comes from", header: true,
        value: (row) => make("div", { className: "origin" }, row.name, ...(row.origin ? [make("small", {}, row.origin)] : [])) },
      { title: "Quantity", value: (row) => row.quantity },
      { title: "Status", value: (row) => row.status,
        tone: (row) => (row.status === "ok" ? "good" : row.status === "constant" ? "" : "bad") },
      { title: "Min / mean / max", unit: "of counters: increase, mean rate", wide: true, value: (row) => row.values },
      { title: "Samples", unit: "changes", right: true, value: (row) => withRange(String(row.samples), String(row.updates)) },
      { title: "Polled every", unit: "changes every", right: true, value: (row) => withRange(row.polled, row.updated) },
      { title: "One read", unit: "costs", right: true, value: (row) => row.read_cost },
    ], data.sensor_rows));
  }

  function fillDevice() {
    const rows = [];
    for (const [group, object] of [["device", report.device], ["host", run.host || {}]])
      for (const [name, value] of Object.entries(object))
        rows.push({ group, name, text: value === null ? unknown : typeof value === "string" ? value : JSON.stringify(value) });
    if (rows.length === 0) body("device").append(note("The run names neither device nor host."));
    else
      body("device").append(table("The machine, as the recorder found it.", [
        { title: "Of", value: (row) => row.group },
        { title: "What", header: true, value: (row) => row.name },
        { title: "Value", wide: true, value: (row) => row.text },
      ], rows));
  }

  function fillUnseen() {
    if (data.answer.length > 1) body("unseen").append(make("p", {}, data.answer[data.answer.length - 1]));
    if (report.missing_sensors.length === 0)
      body("unseen").append(note("The recorder lists no missing sensor."));
    else
      body("unseen").append(table("Sensors that could not be read here.", [
        { title: "Source", header: true, value: (row) => row.source },
        { title: "Why", wide: true, value: (row) => row.reason },
        { title: "What to do", wide: true, value: (row) => row.fix || "-" },
      ], report.missing_sensors));
    if (report.device_refusals.length > 0)
      body("unseen").append(make("h3", {}, "Devices that were not used"),
        list(report.device_refusals.map((row) => `${row.name}: ${row.reason}`)));
  }

  function fillNotes() {
    body("warnings").append(report.warnings.length > 0 ? list(report.warnings) : note("None."));
    if (run.config)
      body("method").append(make("details", {}, make("summary", {}, "The config with every default"),
        make("pre", {}, JSON.stringify(run.config, null, 2))));
    const events = report.events;
    if (data.idle_text) body("events").append(note(data.idle_text));
    if (events.length === 0) body("events").append(note("Nothing else happened that was noted."));
    else {
      const grid = table("What happened during the run.", [
        { title: "At", unit: "s", right: true, value: (row) => fixed(row.t_s, 3) },
        { title: "Severity", value: (row) => row.severity,
          tone: (row) => (row.severity === "info" ? "" : "bad") },
        { title: "Kind", value: (row) => row.kind },
        { title: "What", wide: true, value: (row) => row.text },
      ], events);
      body("events").append(events.length <= 20 ? grid
        : make("details", {}, make("summary", {}, `${plural(report.event_count, "event")}`), grid));
    }
    if (report.event_count > events.length)
      body("events").append(note(`${report.event_count - events.length} more are in report.json.`));
    body("cost").append(data.sampler.length > 0 ? list(data.sampler) : note("Not recorded."));
  }

  // ---- the chart

  const frameHeight = 260;
  const trackHeight = 96;
  const laneHeight = 32;
  const gap = 54;
  const labelHeight = 20;
  const top = 66;
  const cut = (text) => text.replace(/\n/g, " ");
  let chart = null;
  let place = "";

  const placeOf = (cell) => JSON.stringify([cell.model, cell.view]);
  const hasFrames = report.cells.length > 0;

  // Index of the last time at or before t; -1 before the first.
  function lastBefore(times, t) {
    let low = 0;
    let high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  // A rate stands at the end of its window, any other value holds until the next.
  function valueAt(track, channel, t) {
    const index = lastBefore(channel.t_s, t);
    return channel.value[track.is_rate && channel.t_s[index] !== t ? index + 1 : index];
  }

  const isShown = (cell) => !place || placeOf(cell) === place;

  // An outlier where there is one, else the nearest frame.
  function nearestFrame(t, reach) {
    let best = null;
    report.cells.forEach((cell, index) => {
      if (!isShown(cell)) return;
      for (const point of points[index]) {
        if (!point) continue;
        const distance = Math.abs(point[0] - t) * (point[3] === undefined ? 1 : 0.2);
        if (distance <= reach && (!best || distance < best.distance)) best = { distance, cell, point };
      }
    });
    return best;
  }

  const activeBands = (t) => data.bands.filter((band) => band.spans.some(([begin, end]) => begin <= t && t < end));

  function line(left, right) {
    return make("div", {}, make("span", {}, left), make("span", {}, right));
  }

  function tip(t) {
    const box = make("div", { className: "tip" }, line("time", `${t.toFixed(4)} s`));
    const span = visibleSpan();
    const found = nearestFrame(t, span / 100);
    if (found) {
      const { cell, point } = found;
      box.append(make("b", {}, `${cell.algorithm}, ${cell.model}, view ${cell.view}`),
        line(`frame ${point[2]}`, scaledMs(point[1])));
      const index = point[3];
      if (index !== undefined) {
        const rows = [line("outlier", `${ratioOf(index)} times its fast regime`),
          line("cause", data.causes[outliers.cause[index]]),
          line("confidence", confidence(index)),
          ...evidenceLines(index).map((text, i) => line(i === 0 ? "evidence" : "", text))];
        box.append(make("section", { className: "cause" }, ...rows));
      }
    }
    for (const band of activeBands(t))
      box.append(line(bandName(band), band.channels.slice(0, 3).join(", ")));
    if (isNarrow()) return box;
    for (const track of data.tracks) {
      box.append(make("b", {}, `${track.title} [${track.unit}]`));
      for (const channel of track.channels.slice(0, 6)) {
        const value = valueAt(track, channel, t);
        box.append(line(channel.name, value === undefined ? "-" : axisNumber(+value.toPrecision(4))));
      }
      if (track.channels.length > 6) box.append(line(`and ${track.channels.length - 6} more`, ""));
    }
    return box;
  }

  const duration = Math.max(run.duration_s, 1e-3);

  function visibleSpan() {
    const zoom = chart && chart.getOption().dataZoom[0];
    return zoom ? ((zoom.end - zoom.start) / 100) * duration : duration;
  }

  const bandClass = (band) => (band.class === "none" ? "no reason given" : band.class.replace(/_/g, " "));
  const bandName = (band) => `throttled: ${bandClass(band)}${band.inferred ? " (inferred)" : ""}`;
  const bandTitle = (band) => `${bandName(band)}, by ${band.channels.slice(0, 2).join(", ")}`
    + (band.channels.length > 2 ? ` and ${band.channels.length - 2} more` : "");
  const shownCauses = () => data.causes.map((name, cause) => cause)
    .filter((cause) => outliers.cause.some((each, i) => each === cause && isShown(report.cells[outliers.cell[i]])));

  // Hatched in the band's colour, for what was inferred; told apart from filled bands without colours.
  function hatched(color) {
    const tile = make("canvas", { width: 6, height: 6 });
    const pen = tile.getContext("2d");
    pen.strokeStyle = color;
    pen.lineWidth = 1.6;
    for (const shift of [-6, 0, 6]) {
      pen.beginPath();
      pen.moveTo(shift, 6);
      pen.lineTo(shift + 6, 0);
      pen.stroke();
    }
    return { image: tile, repeat: "repeat" };
  }

  // Behind the frames, or as a bar in the lane of its own.
  function bandSeries(band, axis, lane) {
    const color = bandColor(band.class);
    const opacity = lane === undefined ? (band.inferred ? 0.3 : 0.2) : 1;
    const corner = (x, y) => (lane === undefined ? { xAxis: x } : { xAxis: x, yAxis: y });
    return { name: bandName(band), type: "line", xAxisIndex: axis, yAxisIndex: axis, data: [], color, animation: false,
      markArea: { silent: true, animation: false,
        itemStyle: { color: band.inferred ? hatched(color) : color, opacity, borderColor: color,
          borderWidth: lane === undefined ? 0 : 1 },
        data: band.spans.map(([begin, end]) => [corner(begin, lane + 0.5), corner(end, lane + 0.92)]) } };
  }

  function causeSeries(cause) {
    const at = [];
    for (let i = 0; i < drawnCount; ++i)
      if (outliers.cause[i] === cause && isShown(report.cells[outliers.cell[i]]))
        at.push([outliers.t_s[i], outliers.ms[i]]);
    return { name: data.causes[cause], type: "scatter", xAxisIndex: 0, yAxisIndex: 0, data: at,
      symbol: causeSymbols[cause], symbolSize: drawnCount > 500 ? 6 : 10, animation: false,
      progressive: 2000, progressiveThreshold: 5000,
      emphasis: { disabled: true }, color: causeColor(cause), z: 5,
      itemStyle: { color: causeColor(cause), borderColor: css("--ground"), borderWidth: 0.4 } };
  }

  function frameSeries() {
    const dense = points.reduce((sum, cell) => sum + cell.length, 0) > 6000;
    const lines = [];
    report.cells.forEach((cell, index) => {
      if (!isShown(cell)) return;
      lines.push({ name: cell.algorithm, type: "line", xAxisIndex: 0, yAxisIndex: 0,
        data: points[index].map((point) => (point ? [point[0], point[1]] : [null, null])),
        showSymbol: !dense, symbol: "circle", symbolSize: 3, lineStyle: { width: 1 },
        color: colorOf(cell.algorithm), emphasis: { disabled: true }, animation: false });
    });
    return [...data.bands.map((band) => bandSeries(band, 0)), ...lines, ...shownCauses().map(causeSeries)];
  }

  function trackSeries(track, axis) {
    return track.channels.map((channel, index) => ({
      name: channel.name, type: "line", xAxisIndex: axis, yAxisIndex: axis,
      data: channel.t_s.map((t, i) => [t, channel.value[i]]),
      step: track.is_rate ? "start" : "end", showSymbol: channel.t_s.length < 2,
      lineStyle: { width: 1.2 }, areaStyle: track.is_flag ? { opacity: 0.25 } : undefined,
      color: palette()[index % palette().length], animation: false, emphasis: { disabled: true },
    }));
  }

  // Too narrow for wide margins, and for a tip that names every channel.
  const isNarrow = () => byId("chart").clientWidth < 620;

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // Where each grid stands: the frames first, then a lane per class of throttling, then the tracks.
  function rows() {
    const grids = [...(hasFrames ? [{ frames: true, height: frameHeight, title: "frame time" }] : []),
      ...(data.bands.length > 0 ? [{ bands: true, height: laneHeight * data.bands.length, title: "" }] : []),
      ...data.tracks.map((track) => ({ track, height: trackHeight, title: `${track.title} [${track.unit}]` }))];
    let y = top;
    return grids.map((grid, index) => {
      const labelled = printing || index === 0 || index === grids.length - 1;
      if (grid.bands && index > 0) y -= laneHeight;
      const row = { ...grid, y, labelled };
      y += grid.height + gap + (labelled ? labelHeight : 0);
      return row;
    });
  }

  const totalHeight = (all) => (all.length === 0 ? 0 : all[all.length - 1].y + all[all.length - 1].height + 92);

  function option() {
    const soft = css("--soft");
    const all = rows();
    const left = isNarrow() ? 52 : 72;
    const legend = (row) => ({
      type: "scroll", left, right: 12, top: row.y - 26, height: 20, itemHeight: 8, itemWidth: 14, show: !row.bands,
      itemStyle: { borderWidth: 0 },
      textStyle: { color: css("--ink"), fontSize: 11, lineHeight: 16 }, pageIconColor: css("--accent"),
      pageIconInactiveColor: css("--line"), pageTextStyle: { color: soft }, pageIconSize: 11,
      inactiveColor: css("--line"), selectedMode: "multiple",
      data: row.frames
        ? [...algorithms, ...shownCauses().map((cause) => ({ name: data.causes[cause], icon: causeSymbols[cause] }))]
        : row.track ? row.track.channels.map((channel) => channel.name) : [],
      formatter: cut,
    });
    const yAxis = (row, index) => {
      if (row.bands) return { type: "value", gridIndex: index, min: 0, max: data.bands.length, inverse: true, show: false };
      const flag = !row.frames && row.track.is_flag;
      return {
        type: row.frames && byId("logarithmic").checked ? "log" : "value", gridIndex: index,
        scale: !row.frames && !flag && !row.track.is_rate, min: flag ? 0 : undefined,
        max: flag ? 1 : undefined, splitNumber: row.frames ? 5 : 2, minInterval: flag ? 1 : undefined,
        axisLabel: { color: soft, fontSize: 11, hideOverlap: true,
          formatter: row.frames ? axisMs : axisNumber },
        splitLine: { lineStyle: { color: css("--grid") } },
        axisPointer: { show: false },
      };
    };
    const titles = all.flatMap((row) => (row.bands
      ? data.bands.map((band, lane) => ({ text: bandTitle(band), left: left - 5, top: row.y + lane * laneHeight - 4,
        textStyle: { color: css("--ink"), fontSize: 11, fontWeight: 400, width: byId("chart").clientWidth - left - 20,
          overflow: "truncate" } }))
      : [{ text: row.title, left: left - 5, top: row.y - 46, textStyle: { color: css("--ink"), fontSize: 12, fontWeight: 600 } }]));
    return {
      animation: false, backgroundColor: "transparent",
      textStyle: { fontFamily: getComputedStyle(document.body).fontFamily },
      title: titles,
      legend: all.map(legend),
      grid: all.map((row) => ({ left, right: 16, top: row.y, height: row.height })),
      xAxis: all.map((row, index) => ({
        type: "value", gridIndex: index, min: 0, max: duration,
        axisLabel: { show: row.labelled, color: soft, fontSize: 11, hideOverlap: true, showMaxLabel: false,
          formatter: (value) => `${+value.toPrecision(6)} s` },
        axisLine: { onZero: false, lineStyle: { color: css("--line") } },
        axisTick: { lineStyle: { color: css("--line") } },
        splitLine: { show: false },
        axisPointer: { show: true, type: "line", lineStyle: { color: soft }, label: { show: false } },
      })),
      yAxis: all.map(yAxis),
      axisPointer: { link: [{ xAxisIndex: "all" }] },
      tooltip: {
        trigger: "axis", confine: true, transitionDuration: 0, backgroundColor: css("--panel"),
        borderColor: css("--line"), textStyle: { color: css("--ink") },
        formatter: (found) => tip(Number((Array.isArray(found) ? found[0] : found).axisValue)),
      },
      toolbox: {
        show: !printing, right: 12, top: 4, itemSize: 14, iconStyle: { borderColor: soft },
        feature: {
          dataZoom: { xAxisIndex: "all", yAxisIndex: "none", filterMode: "none",
            title: { zoom: "zoom into a stretch", back: "back" } },
          restore: { title: "all" },
          saveAsImage: { title: "save as image", name: "energyprof", backgroundColor: css("--ground") },
        },
      },
      dataZoom: [
        { type: "inside", xAxisIndex: "all", filterMode: "none", zoomOnMouseWheel: "ctrl",
          moveOnMouseMove: false, preventDefaultMouseMove: false },
        { type: "slider", show: !printing, xAxisIndex: "all", filterMode: "none", bottom: 14, height: 24, left, right: 16,
          showDataShadow: false, showDetail: false, borderColor: css("--line"),
          fillerColor: "rgba(120, 150, 180, .22)", handleStyle: { color: css("--soft") },
          moveHandleStyle: { color: css("--line") } },
      ],
      series: all.flatMap((row, index) => (row.frames ? frameSeries()
        : row.bands ? data.bands.map((band, lane) => bandSeries(band, index, lane)) : trackSeries(row.track, index))),
    };
  }

  // ---- charts beside the one over time

  const charts = {};

  function drawInto(id, height, next) {
    const node = byId(id);
    if (node.closest("[hidden]")) return;
    node.style.height = `${height}px`;
    if (!charts[id]) charts[id] = echarts.init(node);
    charts[id].resize();
    charts[id].setOption(next, true);
  }

  const axis = (name, type, more) => ({ type, name, nameLocation: "middle", nameGap: 32, scale: true,
    nameTextStyle: { color: css("--soft"), fontSize: 11 },
    axisLabel: { color: css("--soft"), fontSize: 11, hideOverlap: true },
    axisLine: { lineStyle: { color: css("--line") } }, splitLine: { lineStyle: { color: css("--grid") } }, ...more });

  const plain = (legend, more) => ({
    animation: false, backgroundColor: "transparent",
    textStyle: { fontFamily: getComputedStyle(document.body).fontFamily },
    grid: { left: 68, right: 24, top: 62, bottom: 52 },
    legend: { type: "scroll", top: 8, left: 0, right: 0, itemHeight: 9, itemWidth: 14, data: legend, formatter: cut,
      textStyle: { color: css("--ink"), fontSize: 11, lineHeight: 16 }, pageIconColor: css("--accent"),
      pageIconInactiveColor: css("--line"), pageTextStyle: { color: css("--soft") }, pageIconSize: 11,
      inactiveColor: css("--line") },
    tooltip: { trigger: "item", confine: true, transitionDuration: 0, backgroundColor: css("--panel"),
      borderColor: css("--line"), textStyle: { color: css("--ink"), fontSize: 12 },
      formatter: (found) => make("div", { className: "tip" }, found.data.text || found.seriesName) },
    ...more });

  // Frame time against a channel (a point per frame) or against the work of a cell (a point per cell).
  const perCell = [["node_visits_per_ray", "node visits per ray"], ["box_tests_per_ray", "box tests per ray"],
    ["prim_tests_per_ray", "triangle tests per ray"], ["loop_steps_per_ray", "loop steps per ray"],
    ["simd_efficiency", "SIMD efficiency"], ["bytes_per_pixel_modelled", "bytes per pixel, modelled"],
    ["l1_misses_per_ray_modelled", "L1 misses per ray, modelled"],
    ["llc_misses_per_ray_modelled", "LLC misses per ray, modelled"]]
    .filter(([name]) => report.cells.some((cell) => cell.work[name] !== null));

  function channelScatter(channel) {
    const normal = new Map(algorithms.map((name) => [name, []]));
    const slow = new Map(data.causes.map((name, cause) => [cause, []]));
    channel.value.forEach((value, i) => {
      if (value === null) return;
      const cell = report.cells[data.scatter.cell[i]];
      const index = data.scatter.outlier[i];
      const text = `${cell.algorithm}, ${cell.model}, view ${cell.view}: ${scaledMs(data.scatter.ms[i])} at `
        + `${+value.toPrecision(4)} ${channel.unit}`;
      if (index === null) normal.get(cell.algorithm).push({ value: [value, data.scatter.ms[i]], text });
      else slow.get(outliers.cause[index]).push({ value: [value, data.scatter.ms[i]], text: outlierText(index) });
    });
    const series = [...normal].map(([name, at]) => ({ name, type: "scatter", data: at, symbolSize: 4,
      color: colorOf(name), itemStyle: { opacity: 0.6 }, animation: false }));
    for (const [cause, at] of slow)
      if (at.length > 0)
        series.push({ name: data.causes[cause], type: "scatter", data: at, symbol: causeSymbols[cause],
          symbolSize: 8, color: causeColor(cause), animation: false });
    return { series, name: `${channel.name} [${channel.unit}]` };
  }

  function cellScatter([key, title]) {
    const series = algorithms.map((name) => ({ name, type: "scatter", symbolSize: 9, color: colorOf(name), animation: false,
      data: report.cells.filter((cell) => cell.algorithm === name && cell.work[key] !== null).map((cell) => ({
        value: [cell.work[key], cell.median_ms],
        text: `${name}, ${cell.model}, view ${cell.view}: median ${scaledMs(cell.median_ms)} at ${+cell.work[key].toPrecision(4)} ${title}` })) }));
    return { series, name: title };
  }

  function drawScatter() {
    const [kind, index] = byId("factor").value.split(":");
    if (!index) return;
    const { series, name } = kind === "channel" ? channelScatter(data.scatter.channels[index]) : cellScatter(perCell[index]);
    byId("scatter_chart").setAttribute("aria-label", `Frame time against ${name}. The tables of channels and of work hold the numbers.`);
    drawInto("scatter_chart", 380, plain(series.map((each) => each.name), {
      xAxis: axis(name, "value"),
      yAxis: axis("", byId("scatter_log").checked ? "log" : "value",
        { axisLabel: { color: css("--soft"), fontSize: 11, formatter: axisMs } }),
      series }));
  }

  function fillScatter() {
    const select = byId("factor");
    const channels = make("optgroup", { label: "each frame, against a channel" });
    const [strongest] = report.correlations.filter((row) => row.verdict.startsWith("related")).sort((a, b) => strength(b) - strength(a));
    const clock = report.sensors.find((sensor) => sensor.quantity === "frequency" && sensor.updates > 0);
    const first = strongest ? strongest.y : clock ? clock.name : "";
    data.scatter.channels.forEach((channel, i) => channels.append(make("option",
      { value: `channel:${i}`, selected: channel.name === first }, channel.name)));
    const work = make("optgroup", { label: "medians, against the work of a model, view and algorithm" });
    perCell.forEach(([, title], i) => work.append(make("option", { value: `cell:${i}` }, title)));
    select.append(...[channels, work].filter((group) => group.children.length > 0));
    const empty = select.options.length === 0;
    byId("scatter").querySelector(".controls").hidden = empty;
    byId("scatter_chart").hidden = empty;
    byId("scatter_log").checked = byId("logarithmic").checked;
    if (empty) body("scatter").append(note("No channel and no counted work to compare frame times with."));
    else if (data.scatter.ms.length < data.scatter.frames)
      body("scatter").append(note(`${data.scatter.ms.length} of ${data.scatter.frames} frames are drawn; of the outliers those that lost most time.`));
    select.addEventListener("change", drawScatter);
    byId("scatter_log").addEventListener("change", drawScatter);
  }

  // ---- time against energy

  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

  function paretoPoints() {
    return report.energy.filter((row) => row.nj_per_ray.value !== null).map((row) => ({ row,
      ms: mean(report.cells.filter((cell) => cell.model === row.model && cell.algorithm === row.algorithm)
        .map((cell) => cell.median_ms)) }));
  }

  // Those that no other is faster and thriftier than.
  function front(all) {
    let least = Infinity;
    return [...all].sort((a, b) => a.ms - b.ms || a.row.nj_per_ray.value - b.row.nj_per_ray.value).filter((point) => {
      const is = point.row.nj_per_ray.value < least;
      if (is) least = point.row.nj_per_ray.value;
      return is;
    });
  }

  const modelShapes = [["circle", "circle"], ["rect", "square"], ["triangle", "triangle"], ["diamond", "diamond"],
    ["pin", "pin"], ["arrow", "arrow head"]];
  const shapeOf = (model, models) => modelShapes[models.indexOf(model) % modelShapes.length];
  const modelsOf = (all) => [...new Set(all.map((point) => point.row.model))];

  function drawPareto() {
    const all = paretoPoints();
    if (all.length === 0) return;
    const models = modelsOf(all);
    const best = new Set(models.flatMap((model) => front(all.filter((point) => point.row.model === model))));
    const series = algorithms.map((name) => ({ name, type: "scatter", symbolSize: 12, color: colorOf(name), animation: false,
      data: all.filter((point) => point.row.algorithm === name).map((point) => ({
        value: [point.ms, point.row.nj_per_ray.value], symbol: shapeOf(point.row.model, models)[0],
        text: `${name}, ${point.row.model}: ${scaledMs(point.ms)}, ${estimateText(point.row.nj_per_ray, 1e-9, "J")} a ray`,
        label: { show: best.has(point), formatter: name, position: [...best].indexOf(point) % 2 === 0 ? "top" : "bottom", distance: 8, fontSize: 11, color: css("--ink") } })),
    }));
    const thin = { type: "line", showSymbol: false, silent: true, animation: false, color: css("--soft") };
    for (const { row, ms: at } of all)
      series.push({ ...thin, lineStyle: { width: 1.5, color: colorOf(row.algorithm) },
        data: [[at, row.nj_per_ray.low], [at, row.nj_per_ray.high]] });
    for (const model of models)
      series.push({ ...thin, lineStyle: { width: 1, type: "dashed" }, z: 1,
        data: [...best].filter((point) => point.row.model === model).map((point) => [point.ms, point.row.nj_per_ray.value]) });
    drawInto("pareto", 340, plain(algorithms, {
      xAxis: axis("median frame time, mean over views [ms]", "value"),
      yAxis: axis("net energy per ray [nJ]", "value", { nameGap: 50 }), series }));
  }

  // ---- theory against measurement

  const orderOf = (algorithm) => (algorithm === "GRID"
    ? { name: "n^(1/3)", of: Math.cbrt } : { name: "log n", of: (n) => Math.log2(n) });

  function theoryRows() {
    const rows = [];
    for (const algorithm of algorithms) {
      const sizes = [];
      for (const model of new Set(report.cells.map((cell) => cell.model))) {
        const structure = report.structures.find((each) => each.model === model && each.algorithm === algorithm);
        const scores = report.cells.filter((cell) => cell.model === model && cell.algorithm === algorithm
          && cell.score_ms !== null).map((cell) => cell.score_ms);
        if (structure && structure.triangle_count > 1 && scores.length > 0)
          sizes.push({ algorithm, model, n: structure.triangle_count, ms: mean(scores) });
      }
      sizes.sort((a, b) => a.n - b.n);
      if (sizes.length < 2 || sizes[0].n === sizes[sizes.length - 1].n) continue;
      const order = orderOf(algorithm);
      for (const size of sizes)
        rows.push({ ...size, order: order.name, expected: sizes[0].ms * order.of(size.n) / order.of(sizes[0].n) });
    }
    return rows;
  }

  function fillTheory() {
    const rows = theoryRows();
    byId("theory_chart").hidden = rows.length === 0;
    if (rows.length === 0) {
      body("theory").append(note("It takes two models of different size to see how time grows; this run has fewer."));
      return;
    }
    const whole = (value) => value.toLocaleString("en");
    body("theory").append(
      note("Solid: the measured score, mean over views. Dashed: what the order of growth predicts from the smallest model."),
      table("How scores grow with the number of triangles n.", [
        { title: "Algorithm", value: (row) => named(row.algorithm) },
        { title: "Model", header: true, value: (row) => row.model },
        { title: "Triangles", right: true, value: (row) => whole(row.n) },
        { title: "Measured", unit: "ms", right: true, value: (row) => ms(row.ms) },
        { title: "Order", value: (row) => row.order },
        { title: "Expected", unit: "ms", right: true, value: (row) => ms(row.expected) },
        { title: "Measured / expected", right: true, value: (row) => fixed(row.ms / row.expected, 2) },
      ], rows));
  }

  function drawTheory() {
    const rows = theoryRows();
    if (rows.length === 0) return;
    const series = [];
    for (const name of algorithms) {
      const own = rows.filter((row) => row.algorithm === name);
      if (own.length === 0) continue;
      const { of } = orderOf(name);
      const [least, most] = [own[0].n, own[own.length - 1].n];
      const steps = Array.from({ length: 41 }, (_, i) => least * (most / least) ** (i / 40));
      series.push({ name, type: "line", color: colorOf(name), symbolSize: 8, animation: false,
        data: own.map((row) => ({ value: [row.n, row.ms], text: `${name}, ${row.model}: ${scaledMs(row.ms)}, ${scaledMs(row.expected)} expected` })) });
      series.push({ name: `${name}, ${own[0].order}`, type: "line", color: colorOf(name), showSymbol: false, silent: true, animation: false,
        lineStyle: { type: "dashed", width: 1.2 }, data: steps.map((n) => [n, own[0].ms * of(n) / of(least)]) });
    }
    drawInto("theory_chart", 360, plain(series.filter((each) => !each.silent).map((each) => each.name), {
      xAxis: axis("triangles", "log"), yAxis: axis("score [ms]", "value", { nameGap: 46, scale: false }), series }));
  }

  // ---- zoom by keyboard, and a walk through the outliers

  function zoomTo(start, end) {
    const width = Math.min(100, Math.max(0.01, end - start));
    const from = Math.min(Math.max(0, start), 100 - width);
    chart.dispatchAction({ type: "dataZoom", start: from, end: from + width });
  }

  function zoomBy(factor, shift) {
    const { start, end } = chart.getOption().dataZoom[0];
    const width = (end - start) * factor;
    const middle = (start + end) / 2 + shift * (end - start);
    zoomTo(middle - width / 2, middle + width / 2);
  }

  let outlierAt = -1;

  function walk(step) {
    if (drawnCount === 0) return;
    outlierAt = (outlierAt + step + drawnCount) % drawnCount;
    const index = byTime[outlierAt];
    const at = (100 * outliers.t_s[index]) / duration;
    zoomTo(at - 1, at + 1);
    byId("outlier_text").textContent = `${outlierAt + 1} of ${drawnCount}. ${outlierText(index)}`;
  }

  function fillZoom() {
    const actions = { zoom_in: () => zoomBy(0.5, 0), zoom_out: () => zoomBy(2, 0), zoom_earlier: () => zoomBy(1, -0.5),
      zoom_later: () => zoomBy(1, 0.5), zoom_all: () => zoomTo(0, 100), outlier_before: () => walk(outlierAt < 0 ? 0 : -1),
      outlier_next: () => walk(1) };
    for (const [id, action] of Object.entries(actions))
      byId(id).addEventListener("click", () => { if (chart) action(); });
    for (const id of ["outlier_before", "outlier_next"]) byId(id).hidden = drawnCount === 0;
  }

  function draw() {
    drawTime();
    drawScatter();
    drawPareto();
    drawTheory();
  }

  // ---- on paper

  // Charts as still pictures as wide as the page; the one over time in pieces of a track each, so that none is cut by
  // the end of a page.
  function putOnPaper() {
    const pieces = (id, all, cuts) => {
      const whole = all.renderToCanvas({ pixelRatio: 2, backgroundColor: "#ffffff" });
      const scale = whole.width / all.getWidth();
      const edges = [0, ...cuts.map((y) => Math.round(y * scale)), whole.height];
      const node = byId(id);
      const made = edges.slice(1).map((end, i) => {
        const piece = make("canvas", { className: "paper", width: whole.width, height: end - edges[i] });
        const part = [whole.width, end - edges[i]];
        piece.getContext("2d").drawImage(whole, 0, edges[i], ...part, 0, 0, ...part);
        piece.setAttribute("role", "img");
        piece.setAttribute("aria-label", node.getAttribute("aria-label"));
        return piece;
      });
      node.after(...made);
    };
    if (chart) pieces("chart", chart, rows().filter((row, index) => row.track && index > 0).map((row) => row.y - 50));
    for (const [id, each] of Object.entries(charts)) pieces(id, each, []);
  }

  const paperWidth = 960;
  let opened = [];

  function beforePrint() {
    if (printing) return;
    setPrinting(true);
    opened = [...document.querySelectorAll("main details:not([open])")];
    for (const details of opened) details.open = true;
    draw();
    putOnPaper();
  }

  function afterPrint() {
    if (!printing) return;
    for (const piece of document.querySelectorAll(".paper")) piece.remove();
    for (const details of opened) details.open = false;
    setPrinting(false);
    draw();
  }

  function setPrinting(is) {
    printing = is;
    document.documentElement.classList.toggle("printing", is);
    for (const node of document.querySelectorAll(".chart")) node.style.width = is ? `${paperWidth}px` : "";
  }

  function drawTime() {
    paintKeys();
    const all = rows();
    if (all.length === 0) return;
    byId("chart").style.height = `${totalHeight(all)}px`;
    if (!chart) chart = echarts.init(byId("chart"));
    const zoom = chart.getOption() ? chart.getOption().dataZoom[0] : null;
    chart.resize();
    const next = option();
    if (zoom) for (const part of next.dataZoom) Object.assign(part, { start: zoom.start, end: zoom.end });
    chart.setOption(next, true);
  }

  function fillChart() {
    const places = [...new Set(report.cells.map(placeOf))];
    const select = byId("place");
    select.append(make("option", { value: "" }, "every model and view"));
    for (const each of places) {
      const [model, view] = JSON.parse(each);
      select.append(make("option", { value: each }, `${model}, view ${view}`));
    }
    byId("frame_controls").hidden = !hasFrames;
    byId("zoom_controls").hidden = !hasFrames && data.tracks.length === 0;
    select.addEventListener("change", () => { place = select.value; drawTime(); });
    byId("logarithmic").checked = outliers.ms.some((value, i) => ratioOf(i) > 10);
    byId("logarithmic").addEventListener("change", drawTime);

    const notes = body("time");
    if (!hasFrames && data.tracks.length === 0) notes.append(note("There is nothing to draw."));
    else notes.append(make("p", { className: "note on_screen" }, "Drag the slider, use the buttons, pinch, or hold Ctrl and turn the wheel, to zoom; the magnifier above the chart zooms into a stretch that is drawn with the mouse. All tracks follow."));
    if (outlierCount > 0 || data.bands.length > 0) notes.append(note("Marks are outliers, their colour and shape the cause; bands are throttling, each class in a lane below: filled where a sensor said so, hatched where it was inferred from the clock."));
    if (drawnCount < outlierCount)
      notes.append(note(`${drawnCount} of ${outlierCount} outliers are drawn, those that lost most time; all are in report.json and in timeline.json.`));
    for (const band of data.bands)
      if (band.closed !== null) notes.append(note(`${bandName(band)}: gaps up to ${band.closed} are closed in the drawing; the track shows them.`));
    for (const text of new Set(data.tracks.map((track) => track.note).filter(Boolean))) notes.append(note(text));
    const still = data.not_drawn.constant;
    if (still.length > 8)
      notes.append(make("details", {}, make("summary", {}, `Not drawn, as they never changed: ${still.length} channels`), note(`${still.join(", ")}.`)));
    else if (still.length > 0) notes.append(note(`Not drawn, as they never changed: ${still.join(", ")}.`));
    if (data.not_drawn.too_short.length > 0)
      notes.append(note(`Not drawn, as the run is too short for a rate: ${data.not_drawn.too_short.join(", ")}.`));
  }

  function watch() {
    let width = 0;
    new ResizeObserver(() => {
      const now = byId("chart").clientWidth;
      if (now === width || printing) return;
      width = now;
      draw();
    }).observe(byId("chart"));
    // The links of the navigation lead below it, however many lines it takes.
    const nav = document.querySelector("nav");
    new ResizeObserver(() => { document.documentElement.style.scrollPaddingTop = `${nav.offsetHeight + 8}px`; }).observe(nav);
    darkQuery.addEventListener("change", draw);
    window.addEventListener("beforeprint", beforePrint);
    window.addEventListener("afterprint", afterPrint);
    // ECharts takes every turn of the wheel for itself; without Ctrl it is for the page.
    byId("chart").addEventListener("wheel", (event) => { if (!event.ctrlKey) event.stopPropagation(); }, { capture: true, passive: true });
  }

  fillTop();
  fillReadings();
  fillRanking();
  fillChart();
  fillZoom();
  fillOutliers();
  fillRelations();
  fillScatter();
  fillFactors();
  fillTheory();
  fillCells();
  fillEnergy();
  fillImages();
  fillDevice();
  fillSensors();
  fillUnseen();
  fillNotes();
  chooseSections();
  draw();
  watch();
})();
