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

  function scaledMs(value) {
    if (value >= 1000) return `${+(value / 1000).toPrecision(3)} s`;
    if (value >= 1) return `${+value.toPrecision(3)} ms`;
    if (value >= 1e-3) return `${+(value * 1e3).toPrecision(3)} µs`;
    return `${+(value * 1e6).toPrecision(3)} ns`;
  }

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
    const grid = make("table", {}, make("caption", {}, caption), make("thead", {}, head),
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
  const darkQuery = window.matchMedia("(prefers-color-scheme: dark)");
  let printing = false;
  const palette = () => palettes[darkQuery.matches && !printing ? "dark" : "light"];
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
  }

  function named(algorithm) {
    const text = make("span", { className: "named" });
    text.append(key(algorithm), algorithm);
    return text;
  }

  // ---- top of the page

  function fillTop() {
    show("question", run.question);
    show("headline", run.headline);
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
      { title: "Score", unit: "ms", right: true, value: (row) => ms(row.score_ms) },
      { title: "95 %", unit: "ms", right: true,
        value: (row) => range(row.score_low_ms, row.score_high_ms, 3) },
      { title: "Normalized", right: true, value: (row) => fixed(row.normalized, 3) },
      { title: "95 %", right: true,
        value: (row) => (row.rank === 1 ? "-" : range(row.normalized_low, row.normalized_high, 3)) },
      { title: "Times the best", value: (row) => bar(row, longest) },
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
      { title: "Median", unit: "ms", right: true, value: (cell) => ms(cell.median_ms) },
      { title: "95 %", unit: "ms", right: true,
        value: (cell) => range(cell.median_low_ms, cell.median_high_ms, 3) },
      { title: "Truncated mean", unit: "ms", right: true, value: (cell) => ms(cell.truncated_mean_ms) },
      { title: "Std. dev.", unit: "ms", right: true, value: (cell) => ms(cell.stddev_ms) },
      { title: "Outliers", right: true, value: (cell) => String(cell.outlier_count),
        tone: (cell) => (cell.outlier_count > 0 ? "bad" : "") },
      { title: "Mrays/s", right: true, value: (cell) => fixed(cell.mrays_per_s, 2) },
      { title: "Rays", unit: "per frame", right: true, value: (cell) => fixed(cell.rays_per_frame, 0) },
      { title: "Hits", unit: "%", right: true,
        value: (cell) => (cell.hit_ratio === null ? "-" : fixed(100 * cell.hit_ratio, 1)) },
      { title: "Hit checksums", value: checksum,
        tone: (cell) => ({ agree: "good", differ: "bad" })[checksum(cell)] },
      { title: "Clock error", unit: "± µs", right: true, value: (cell) => fixed(cell.clock_error_us, 1) },
    ], report.cells));
    fillOutliers();
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
    const worst = [...report.outliers].sort((a, b) => b.excess_ms - a.excess_ms);
    body("cells").append(make("h3", {}, "Outliers"));
    if (worst.length === 0) {
      body("cells").append(note("No outliers: no timed frame was slow for its trial."));
      return;
    }
    const shown = worst.slice(0, 20);
    body("cells").append(table(
      worst.length > shown.length ? `The slowest ${shown.length} of ${worst.length}; all are in report.json.`
        : `All ${worst.length}, the slowest first.`, [
        { title: "Frame", header: true, right: true, value: (row) => String(row.frame) },
        { title: "Model", value: (row) => row.model },
        { title: "View", right: true, value: (row) => String(row.view) },
        { title: "Algorithm", value: (row) => named(row.algorithm) },
        { title: "At", unit: "s", right: true, value: (row) => fixed((row.begin_ns - run.begin_ns) * 1e-9, 3) },
        { title: "Time", unit: "ms", right: true, value: (row) => ms(row.frame_ms) },
        { title: "Ratio", right: true, value: (row) => fixed(row.ratio, 2) },
        { title: "Excess", unit: "ms", right: true, value: (row) => ms(row.excess_ms) },
        { title: "Cause", value: (row) => row.cause },
      ], shown));
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

  function fillEnergy() {
    if (report.energy.length === 0) {
      body("energy").append(note("No timed frame was recorded, so there is no energy per frame."));
      return;
    }
    const refused = [...new Set(report.energy.map((row) => row.refused).filter(Boolean))];
    if (report.energy.every((row) => row.refused)) {
      body("energy").append(note(`No joules per frame are given: ${refused.join("; ")}.`));
      return;
    }
    const joules = (row) => (row.refused ? "-" : row.joules_per_frame.value.toPrecision(4));
    body("energy").append(table("Joules per frame, net of idle.", [
      { title: "Model", header: true, value: (row) => row.model },
      { title: "Algorithm", value: (row) => named(row.algorithm) },
      { title: "Frames", right: true, value: (row) => String(row.frames) },
      { title: "Energy", unit: "J per frame", right: true, value: joules },
      { title: "Refused", value: (row) => row.refused || "" },
    ], report.energy));
  }

  function fillImages() {
    const pictures = data.images.map((image) =>
      make("figure", {}, make("img", { src: image.src, alt: image.title, loading: "lazy" }),
        make("figcaption", {}, image.title)));
    if (pictures.length > 0) body("images").append(make("div", { className: "pictures" }, ...pictures));
    else if (data.named_images.length === 0) body("images").append(note("The run has no images."));
    if (data.named_images.length > 0)
      body("images").append(note("Beside this page:"), list(data.named_images));
    if (data.images_left_out > 0)
      body("images").append(
        note(`${data.images_left_out} more are in the folder images beside this page; the page would be too large with them.`));
  }

  // A recorded program has no frames; a study's sensors are drawn and listed below its results.
  function chooseSections() {
    const hidden = run.command ? ["ranking", "cells", "work", "energy", "images"] : ["readings"];
    for (const id of hidden) {
      byId(id).hidden = true;
      document.querySelector(`nav a[href="#${id}"]`).hidden = true;
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
      { title: "Channel", header: true, value: (row) => row.name },
      { title: "Quantity", value: (row) => row.quantity },
      { title: "Status", value: (row) => row.status,
        tone: (row) => (row.status === "ok" ? "good" : row.status === "constant" ? "" : "bad") },
      { title: "Min / mean / max", wide: true, value: (row) => row.values },
      { title: "Samples", right: true, value: (row) => String(row.samples) },
      { title: "Changes", right: true, value: (row) => String(row.updates) },
      { title: "Polled every", right: true, value: (row) => row.polled },
      { title: "Changes every", right: true, value: (row) => row.updated },
      { title: "One read costs", right: true, value: (row) => row.read_cost },
      { title: "Origin", value: (row) => make("code", {}, row.origin) },
    ], data.sensor_rows));
  }

  function fillUnseen() {
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
    body("warnings").append(list(report.warnings));
    const events = report.events.filter((event) => event.kind !== "idle" && event.kind !== "sampler-off");
    if (data.idle_text) body("events").append(note(data.idle_text));
    if (events.length === 0) body("events").append(note("Nothing else happened that was noted."));
    else
      body("events").append(table("What happened during the run.", [
        { title: "At", unit: "s", right: true, value: (row) => fixed(row.t_s, 3) },
        { title: "Severity", value: (row) => row.severity,
          tone: (row) => (row.severity === "info" ? "" : "bad") },
        { title: "Kind", value: (row) => row.kind },
        { title: "What", wide: true, value: (row) => row.text },
      ], events.slice(0, 200)));
    if (events.length > 200)
      body("events").append(note(`${events.length - 200} more are in report.json.`));
    body("cost").append(data.sampler.length > 0 ? list(data.sampler) : note("Not recorded."));
  }

  // ---- the chart

  const frameHeight = 260;
  const trackHeight = 96;
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

  function nearestFrame(t, reach) {
    let best = null;
    report.cells.forEach((cell, index) => {
      if (place && placeOf(cell) !== place) return;
      for (const point of data.frames[index]) {
        if (!point) continue;
        const distance = Math.abs(point[0] - t);
        if (distance <= reach && (!best || distance < best.distance)) best = { distance, cell, point };
      }
    });
    return best;
  }

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
        line(`frame ${point[2]}${point[3] ? ", outlier" : ""}`, scaledMs(point[1])));
    }
    for (const track of data.tracks) {
      box.append(make("b", {}, `${track.title} [${track.unit}]`));
      for (const channel of track.channels.slice(0, 6)) {
        const value = valueAt(track, channel, t);
        box.append(line(channel.name, value === undefined ? "-" : String(+value.toPrecision(4))));
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

  function frameSeries() {
    const series = [];
    const outliers = [];
    const dense = data.frames.reduce((sum, points) => sum + points.length, 0) > 6000;
    report.cells.forEach((cell, index) => {
      if (place && placeOf(cell) !== place) return;
      const points = data.frames[index].map((point) => (point ? [point[0], point[1]] : [null, null]));
      series.push({ name: cell.algorithm, type: "line", xAxisIndex: 0, yAxisIndex: 0, data: points,
        showSymbol: !dense, symbol: "circle", symbolSize: 3, lineStyle: { width: 1 },
        color: colorOf(cell.algorithm), emphasis: { disabled: true }, animation: false });
      for (const point of data.frames[index]) if (point && point[3]) outliers.push([point[0], point[1]]);
    });
    series.push({ name: "outlier", type: "scatter", xAxisIndex: 0, yAxisIndex: 0, data: outliers,
      symbol: "diamond", symbolSize: 11, animation: false, emphasis: { disabled: true },
      itemStyle: { color: "transparent", borderColor: css("--bad"), borderWidth: 1.8 } });
    return series;
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

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // Where each grid stands: the frames first, then one per track.
  function rows() {
    const heights = [...(hasFrames ? [frameHeight] : []), ...data.tracks.map(() => trackHeight)];
    let y = top;
    return heights.map((height, index) => {
      const labelled = index === 0 || index === heights.length - 1;
      const row = { y, height, labelled };
      y += height + gap + (labelled ? labelHeight : 0);
      return row;
    });
  }

  const totalHeight = (all) => (all.length === 0 ? 0 : all[all.length - 1].y + all[all.length - 1].height + 92);

  function option() {
    const soft = css("--soft");
    const all = rows();
    const narrow = byId("chart").clientWidth < 620;
    const left = narrow ? 52 : 72;
    const tracks = data.tracks;
    const first = hasFrames ? 1 : 0;
    const titleOf = (index) =>
      hasFrames && index === 0 ? "frame time" : `${tracks[index - first].title} [${tracks[index - first].unit}]`;
    const legend = (index) => ({
      type: "scroll", left, right: 12, top: all[index].y - 26, height: 20, itemHeight: 8, itemWidth: 14,
      textStyle: { color: css("--ink"), fontSize: 11 }, pageIconColor: css("--accent"),
      pageIconInactiveColor: css("--line"), pageTextStyle: { color: soft }, pageIconSize: 11,
      inactiveColor: css("--line"), selectedMode: "multiple",
      data: hasFrames && index === 0 ? [...algorithms, "outlier"]
        : tracks[index - first].channels.map((channel) => channel.name),
      formatter: cut,
    });
    const yAxis = (index) => {
      const frames = hasFrames && index === 0;
      const flag = !frames && tracks[index - first].is_flag;
      return {
        type: frames && byId("logarithmic").checked ? "log" : "value", gridIndex: index,
        scale: !frames && !flag && !tracks[index - first].is_rate, min: flag ? 0 : undefined,
        max: flag ? 1 : undefined, splitNumber: frames ? 5 : 2, minInterval: flag ? 1 : undefined,
        axisLabel: { color: soft, fontSize: 11, hideOverlap: true,
          formatter: frames ? (value) => (value === 0 ? "0" : scaledMs(value)) : undefined },
        splitLine: { lineStyle: { color: css("--grid") } },
        axisPointer: { show: false },
      };
    };
    return {
      animation: false, backgroundColor: "transparent",
      textStyle: { fontFamily: getComputedStyle(document.body).fontFamily },
      title: all.map((row, index) => ({ text: titleOf(index), left: left - 5, top: row.y - 46,
        textStyle: { color: css("--ink"), fontSize: 12, fontWeight: 600 } })),
      legend: all.map((row, index) => legend(index)),
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
      yAxis: all.map((row, index) => yAxis(index)),
      axisPointer: { link: [{ xAxisIndex: "all" }] },
      tooltip: {
        trigger: "axis", confine: true, transitionDuration: 0, backgroundColor: css("--panel"),
        borderColor: css("--line"), textStyle: { color: css("--ink") },
        formatter: (found) => tip(Number((Array.isArray(found) ? found[0] : found).axisValue)),
      },
      toolbox: {
        right: 12, top: 4, itemSize: 14, iconStyle: { borderColor: soft },
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
        { type: "slider", xAxisIndex: "all", filterMode: "none", bottom: 14, height: 24, left, right: 16,
          showDataShadow: false, showDetail: false, borderColor: css("--line"),
          fillerColor: "rgba(120, 150, 180, .22)", handleStyle: { color: css("--soft") },
          moveHandleStyle: { color: css("--line") } },
      ],
      series: [...(hasFrames ? frameSeries() : []),
        ...tracks.flatMap((track, index) => trackSeries(track, index + first))],
    };
  }

  function draw() {
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
    byId("time").querySelector(".controls").hidden = !hasFrames;
    select.addEventListener("change", () => { place = select.value; draw(); });
    byId("logarithmic").checked = report.outliers.some((outlier) => outlier.ratio > 10);
    byId("logarithmic").addEventListener("change", draw);

    const notes = body("time");
    if (!hasFrames && data.tracks.length === 0) notes.append(note("There is nothing to draw."));
    else notes.append(note("Drag the slider, or hold Ctrl and turn the wheel, to zoom; all tracks follow."));
    for (const text of new Set(data.tracks.map((track) => track.note).filter(Boolean))) notes.append(note(text));
    if (data.not_drawn.constant.length > 0)
      notes.append(note(`Not drawn, as they never changed: ${data.not_drawn.constant.join(", ")}.`));
    if (data.not_drawn.too_short.length > 0)
      notes.append(note(`Not drawn, as the run is too short for a rate: ${data.not_drawn.too_short.join(", ")}.`));
  }

  function watch() {
    let width = 0;
    new ResizeObserver(() => {
      const now = byId("chart").clientWidth;
      if (now === width) return;
      width = now;
      draw();
    }).observe(byId("chart"));
    darkQuery.addEventListener("change", draw);
    window.addEventListener("beforeprint", () => { printing = true; draw(); });
    window.addEventListener("afterprint", () => { printing = false; draw(); });
  }

  fillTop();
  fillReadings();
  fillRanking();
  fillChart();
  fillCells();
  fillEnergy();
  fillImages();
  fillSensors();
  fillUnseen();
  fillNotes();
  chooseSections();
  draw();
  watch();
})();
