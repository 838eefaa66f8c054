#!/usr/bin/env python3
"""Draws what scale_bench prints, as SVG: plot_scale.py scale.csv > docs/images/scale.svg

Left: frame time over triangles, measured, with the theory's slopes through the smallest size (log n for
hierarchies, n^(1/3) for the grid). Right: build time per triangle. Both axes are logarithmic.
"""
import csv
import math
import sys

COLORS = {"BVH_FTB_DF": "#1f77b4", "BVH_FTB_BF": "#17becf", "BVH_STACKLESS_DF": "#9467bd",
          "KD_TREE": "#d62728", "KD_STACK": "#ff7f0e", "GRID": "#2ca02c"}
WIDTH, HEIGHT, LEFT, TOP = 460, 340, 60, 40


def read(path):
    series = {}
    with open(path, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            series.setdefault((row["what"], row["name"]), []).append(
                (int(row["triangles"]), float(row["ms"])))
    return series


def panel(x0, title, y_label, lines):
    """SVG of one diagram; `lines`: (name, color, dashed, points)."""
    xs = [x for line in lines for x, _ in line[3]]
    ys = [y for line in lines for _, y in line[3]]
    x_low, x_high = math.log10(min(xs)), math.log10(max(xs))
    y_low, y_high = math.floor(math.log10(min(ys)) * 2) / 2, math.ceil(math.log10(max(ys)) * 2) / 2

    def place(x, y):
        return (x0 + LEFT + (math.log10(x) - x_low) / (x_high - x_low) * WIDTH,
                TOP + (y_high - math.log10(y)) / (y_high - y_low) * HEIGHT)

    out = [f'<text x="{x0 + LEFT}" y="{TOP - 16}" font-weight="bold">{title}</text>',
           f'<rect x="{x0 + LEFT}" y="{TOP}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#888"/>',
           f'<text x="{x0 + LEFT + WIDTH / 2}" y="{TOP + HEIGHT + 40}" text-anchor="middle">triangles</text>',
           f'<text transform="translate({x0 + 14},{TOP + HEIGHT / 2}) rotate(-90)" text-anchor="middle">{y_label}</text>']
    for exponent in range(math.ceil(x_low), math.floor(x_high) + 1):
        x, _ = place(10 ** exponent, 10 ** y_low)
        out.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{TOP + HEIGHT}" stroke="#ddd"/>'
                   f'<text x="{x:.1f}" y="{TOP + HEIGHT + 18}" text-anchor="middle">10^{exponent}</text>')
    for step in range(round(2 * y_low), round(2 * y_high) + 1):
        value = 10 ** (step / 2)
        _, y = place(10 ** x_low, value)
        out.append(f'<line x1="{x0 + LEFT}" x2="{x0 + LEFT + WIDTH}" y1="{y:.1f}" y2="{y:.1f}" stroke="#eee"/>'
                   f'<text x="{x0 + LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:.3g}</text>')
    for _, color, dashed, points in lines:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in (place(*point) for point in points))
        dash = ' stroke-dasharray="5 4" opacity="0.6"' if dashed else ""
        out.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"{dash}/>')
    return "\n".join(out)


def main():
    series = read(sys.argv[1])
    frames, builds = [], []
    for (what, name), points in sorted(series.items()):
        color = COLORS[name]
        if what == "frame":
            frames.append((name, color, False, points))
            n0, t0 = points[0]
            grows = (lambda n: (n / n0) ** (1 / 3)) if name == "GRID" else (
                lambda n: math.log(n) / math.log(n0))
            frames.append((name, color, True, [(n, t0 * grows(n)) for n, _ in points]))
        else:
            builds.append((name, color, what != "build", [(n, 1e6 * ms / n) for n, ms in points]))
    total = 2 * (WIDTH + LEFT) + 60
    legend = "".join(
        f'<rect x="{LEFT + 165 * i}" y="{TOP + HEIGHT + 56}" width="14" height="4" fill="{color}"/>'
        f'<text x="{LEFT + 20 + 165 * i}" y="{TOP + HEIGHT + 62}">{name}</text>'
        for i, (name, color) in enumerate(COLORS.items()))
    print(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} {TOP + HEIGHT + 80}" '
          f'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>')
    print(panel(0, "Frame time; dashed: theory through the smallest size", "ms", frames))
    print(panel(WIDTH + LEFT + 30, "Build time per triangle; dashed: tuned parameters", "ns", builds))
    print(legend + "</svg>")


if __name__ == "__main__":
    main()
