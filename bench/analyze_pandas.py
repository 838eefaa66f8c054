#!/usr/bin/env python3
"""What a notebook with pandas and SciPy takes for the statistics of `energyprof analyze`.

    analyze_pandas.py RUN.sqlite [--plain] [--against REPORT.json]

Aligns every channel to the timed frames, then: Spearman on ranks within cells without trends, p by
circular shifts of the whole run, the best of 17 lags, bootstrap intervals over blocks, Benjamini-Hochberg, Fisher's
test of outliers x throttled frames, energy by windows and above idle. Prints the seconds of each step. With
--against it also compares its Spearman coefficients with those of a report. Shifts go through an FFT and the
bootstrap through sums of blocks, as somebody writes it who has to wait for it; with --plain 10,000 shifts are made
one by one and frames drawn anew for each replicate, as it is written first.

Simpler than energyprof where that does not matter for the time: no partial correlations, no causes, one throttle
series, no regression of energy. Runs of fewer than 10,000 frames have fewer shifts here.
"""

import argparse
import json
import sqlite3
import time

import numpy as np
import pandas as pd
from scipy import fft, stats

LAG_COUNT = 8
REPLICATE_COUNT = 200
PLAIN_SHIFT_COUNT = 10_000
TOLERANCE = 0.005  # of a coefficient: ranks and trends are the same, gaps and rounding are treated differently
TO_SI = {"nJ": 1e-9, "uJ": 1e-6, "mJ": 1e-3, "J": 1.0}


class Clock:
    """Prints how long each step took."""

    def __init__(self):
        self.begin = self.last = time.perf_counter()

    def step(self, name):
        now = time.perf_counter()
        print(f"{name:<24} {now - self.last:8.2f} s")
        self.last = now


def read(path):
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as db:
        frames = pd.read_sql_query(
            "SELECT f.id, f.trial_id, f.begin_ns, f.end_ns, f.ray_count, t.model, t.view, t.algorithm FROM frames f "
            "JOIN trials t ON t.id = f.trial_id WHERE f.phase = 'timed' AND f.end_ns > f.begin_ns ORDER BY f.begin_ns", db)
        trials = pd.read_sql_query("SELECT id, begin_ns, end_ns FROM trials ORDER BY begin_ns", db)
        channels = pd.read_sql_query("SELECT * FROM channels ORDER BY id", db)
        samples = pd.read_sql_query("SELECT channel_id, t_ns, value FROM samples ORDER BY channel_id, t_ns", db)
    frames["cell"] = frames.groupby(["model", "view", "algorithm"]).ngroup()
    frames["ns"] = frames.end_ns - frames.begin_ns
    return frames, trials, channels, {key: group for key, group in samples.groupby("channel_id")}


def unwrapped(channel, series):
    step = np.diff(series.value.to_numpy(dtype=float), prepend=float(series.value.iloc[0]))
    if pd.notna(channel.wrap_at):
        step[step < 0] += channel.wrap_at + 1
    return np.cumsum(np.maximum(step, 0))


def align(channel, series, frames):
    """The channel's mean, or rate, over a usual frame's time around the middle of each frame."""
    t = series.t_ns.to_numpy()
    value = series.value.to_numpy(dtype=float)
    usual = frames.groupby("cell").ns.transform(lambda ns: ns.quantile(0.25)).round().astype(np.int64)
    begin = (frames.begin_ns + frames.ns // 2 - usual // 2).to_numpy()
    end = begin + usual.to_numpy()
    if channel.kind == "cumulative":
        total = unwrapped(channel, series)
        moved = t[np.flatnonzero(np.diff(total)) + 1]
        update = int(np.quantile(np.diff(moved), 0.1, method="lower")) if len(moved) > 8 else 0
        missing = np.maximum(max(update, int(np.median(np.diff(t)))) - (end - begin), 0)
        begin, end = begin - missing // 2, end + missing - missing // 2
        return (np.interp(end, t, total) - np.interp(begin, t, total)) / (end - begin) * 1e9
    if channel.kind == "flag":
        value = (value != 0).astype(float)
    held = np.minimum(np.diff(t, append=t[-1]), 3 * int(np.median(np.diff(t))))
    integral = np.concatenate([[0.0], np.cumsum((value - value[0]) * held)])
    covered = np.concatenate([[0], np.cumsum(held)])

    def up_to(moment):
        i = np.maximum(np.searchsorted(t, moment, side="right") - 1, 0)
        since = np.minimum(np.maximum(moment - t[i], 0), held[i])
        return integral[i] + since * (value[i] - value[0]), covered[i] + since

    (a, a_time), (b, b_time) = up_to(begin), up_to(end)
    first = np.searchsorted(t, np.maximum(begin, frames.begin_ns))
    last = np.searchsorted(t, np.minimum(end, frames.end_ns))
    total = np.concatenate([[0.0], np.cumsum(value - value[0])])
    with np.errstate(divide="ignore", invalid="ignore"):
        held_mean = (b - a) / (b_time - a_time)
        return value[0] + np.where(last > first, (total[last] - total[first]) / (last - first), held_mean)


def trends(frames):
    """An orthonormal basis of what is no relation: per cell a level and the course of a trial, then that of the run."""
    place = frames.groupby("trial_id").cumcount()
    length = frames.groupby("trial_id").id.transform("size")
    u = (2 * place / np.maximum(length - 1, 1) - 1).to_numpy()
    bases = {}
    for cell, rows in frames.groupby("cell").indices.items():
        degree = 0 if len(rows) < 12 else 1 if len(rows) < 32 else 2 if len(rows) < 64 else 3
        bases[cell] = (rows, np.linalg.qr(np.polynomial.legendre.legvander(u[rows], degree))[0])

    def in_cells(x):
        x = x.copy()
        for rows, q in bases.values():
            x[rows] -= q @ (q.T @ x[rows])
        return x

    t = frames.begin_ns.to_numpy(dtype=float)
    course = np.polynomial.legendre.legvander(2 * (t - t[0]) / (t[-1] - t[0]) - 1, 3)[:, 1:]
    q = np.linalg.qr(in_cells(course))[0]
    return lambda x: (lambda inner: inner - q @ (q.T @ inner))(in_cells(x))


def residual_ranks(x, frames, detrended):
    """Ranks within cells, mean 0 and variance 1, without trends; 0 where there is no value."""
    series = pd.Series(x)
    cells = series.groupby(frames.cell.to_numpy())
    ranks = (cells.rank() - 0.5) / cells.transform("count") - 0.5
    return detrended(np.where(series.isna(), 0.0, ranks.to_numpy() * np.sqrt(12)))


def shift_p(x_spectrum, y, trial_length):
    """Without lag and with the best one: p over all circular shifts but the nearest, and that lag."""
    n = len(y)
    sums = fft.irfft(np.conj(x_spectrum) * fft.rfft(y), n)
    window = pd.Series(np.concatenate([np.abs(sums[-LAG_COUNT:]), np.abs(sums), np.abs(sums[:LAG_COUNT])]))
    largest = window.rolling(2 * LAG_COUNT + 1).max().to_numpy()[2 * LAG_COUNT:]
    near = max(min(n // 50, 2 * trial_length), 2 * LAG_COUNT)
    far = slice(near + 1, n - near)
    count = len(sums[far]) + 1
    lags = np.arange(-LAG_COUNT, LAG_COUNT + 1)
    return ((1 + np.sum(np.abs(sums[far]) >= abs(sums[0]))) / count,
            (1 + np.sum(largest[far] >= largest[0])) / count, lags[np.argmax(np.abs(sums[lags]))])


def bootstrap(x, y, random):
    """95 % interval of the coefficient from blocks that are drawn again."""
    n = len(x)
    block = int(np.ceil(n ** (1 / 3)))
    sums = [np.add.reduceat(v, np.arange(0, n, block)) for v in (x * y, x * x, y * y)]
    drawn = random.integers(0, len(sums[0]), (REPLICATE_COUNT, len(sums[0])))
    xy, xx, yy = (v[drawn].sum(axis=1) for v in sums)
    return np.quantile(xy / np.sqrt(xx * yy), [0.025, 0.975])


def plain_shift_p(x, y, trial_length, random):
    """What shift_p gives without lag, from 10,000 shifts made one by one."""
    near = max(len(y) // 50, 2 * trial_length)
    seen = abs(x @ y)
    reached = sum(abs(x @ np.roll(y, shift)) >= seen for shift in random.integers(near, len(y) - near, PLAIN_SHIFT_COUNT))
    return (1 + reached) / (1 + PLAIN_SHIFT_COUNT)


def plain_bootstrap(x, y, random):
    """What bootstrap gives, every replicate drawn frame by frame."""
    n = len(x)
    block = int(np.ceil(n ** (1 / 3)))
    replicates = []
    for _ in range(REPLICATE_COUNT):
        drawn = (random.integers(0, n - block, n // block)[:, None] + np.arange(block)).ravel()
        replicates.append(np.corrcoef(x[drawn], y[drawn])[0, 1])
    return np.quantile(replicates, [0.025, 0.975])


def energy(frames, trials, channel, series):
    """Net joules per frame by algorithm: counter differences over the timed frames of each trial, above idle."""
    total = unwrapped(channel, series) * TO_SI[channel.unit]
    moved = np.flatnonzero(np.diff(total, prepend=total[0] - 1))
    t, joules = series.t_ns.to_numpy()[moved], total[moved]
    begin, end = trials.end_ns.to_numpy()[:-1], trials.begin_ns.to_numpy()[1:]
    margin = (end - begin) // 10
    begin, end = begin + margin, end - margin
    rest = (np.interp(end, t, joules) - np.interp(begin, t, joules)).sum() / ((end - begin).sum() * 1e-9)
    spans = frames.groupby("trial_id").agg(algorithm=("algorithm", "first"), begin=("begin_ns", "first"),
                                           end=("end_ns", "last"), frames=("id", "size"))
    drawn = np.interp(spans.end, t, joules) - np.interp(spans.begin, t, joules)
    spans["net"] = drawn - rest * (spans.end - spans.begin) * 1e-9
    sums = spans.groupby("algorithm")[["net", "frames"]].sum()
    return sums.net / sums.frames


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--against", metavar="REPORT.json")
    arguments = parser.parse_args()
    clock = Clock()
    frames, trials, channels, samples = read(arguments.run)
    clock.step("read")

    signals = {c.name: align(c, samples[c.id], frames) for c in channels.itertuples() if c.id in samples}
    clock.step("align")

    detrended = trends(frames)
    times = residual_ranks(frames.ns, frames, detrended)
    ranked = {name: residual_ranks(x, frames, detrended) for name, x in signals.items()}
    clock.step("rank and detrend")

    trial_length = len(frames) // frames.trial_id.nunique()
    spectrum = fft.rfft(times)
    random = np.random.default_rng(1)
    rows = []
    for name, y in ranked.items():
        size = np.sqrt((times @ times) * (y @ y))
        if size == 0:
            continue
        if arguments.plain:
            p, p_lagged, lag = plain_shift_p(times, y, trial_length, random), np.nan, 0
            low, high = plain_bootstrap(times, y, random)
        else:
            p, p_lagged, lag = shift_p(spectrum, y, trial_length)
            low, high = bootstrap(times, y, random)
        rows.append((name, times @ y / size, low, high, lag, p, p_lagged))
    table = pd.DataFrame(rows, columns=["channel", "rho", "low", "high", "lag_frames", "p", "p_lagged"])
    clock.step("shifts and bootstrap")

    order = table.p.argsort().to_numpy()
    q = table.p.to_numpy()[order] * len(table) / np.arange(1, len(table) + 1)
    table.loc[order, "q"] = np.minimum.accumulate(q[::-1])[::-1]
    outlier = frames.ns > 1.5 * frames.groupby("cell").ns.transform("median")
    throttled = np.zeros(len(frames), dtype=bool)
    for c in channels.itertuples():
        if c.kind == "flag" and c.name in signals:
            throttled |= signals[c.name] > 0
    fisher = stats.fisher_exact(pd.crosstab(outlier, throttled).reindex(
        index=[False, True], columns=[False, True], fill_value=0))
    clock.step("q and Fisher")

    for c in channels.itertuples():
        if c.quantity == "energy" and c.unit in TO_SI and c.id in samples:
            energy(frames, trials, c, samples[c.id])
    clock.step("energy")

    print(f"{'all':<24} {time.perf_counter() - clock.begin:8.2f} s")
    print(f"outliers x throttled: odds ratio {fisher[0]:.3f}, Fisher's p {fisher[1]:.3g}")
    print(table.sort_values("p").head(10).to_string(index=False))
    if arguments.against:
        with open(arguments.against, encoding="utf-8") as file:
            report = json.load(file)
        theirs = {row["y"]: row["coefficient"] for row in report["correlations"]
                  if row["method"] == "spearman" and row["coefficient"] is not None}
        both = table[table.channel.isin(theirs)]
        apart = (both.rho - both.channel.map(theirs)).abs()
        print(f"{len(both)} Spearman coefficients in both, at most {apart.max():.2g} apart")
        if apart.max() > TOLERANCE:
            raise SystemExit(f"more than {TOLERANCE} apart")


if __name__ == "__main__":
    main()
