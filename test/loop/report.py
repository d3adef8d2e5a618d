"""The report: one HTML file with inline SVG, for light and dark, without any network request."""

import base64
import html
import io

import numpy as np
from PIL import Image

import crane as c
import evaluate as e
import figures

STYLE = """
:root { --ink: #282828; --soft: #5c5c5c; --grid: #e1e1e1; --axis: #787878; --back: #ffffff;
  --shade: #ecece2; --truth: #282828; --volant: #cc2c3c; --reference: #267cc4; --third: #008060;
  --bad: #f6dcdc; --rope: #8a6d3b; --body: #4a4c50; color-scheme: light dark; }
@media (prefers-color-scheme: dark) { :root { --ink: #eceae5; --soft: #b9b6ae; --grid: #34363a;
  --axis: #8b8e94; --back: #1d1e21; --shade: #2d2e2a; --truth: #eceae5; --volant: #ff7d86;
  --reference: #6cb6f5; --third: #4fd0a5; --bad: #4a2a2c; --rope: #d9b877; --body: #a5a8ad; } }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; color: var(--ink);
  background: var(--back); margin: 0 auto; max-width: 1000px; padding: 16px; }
h1 { font-size: 26px; } h2 { font-size: 20px; margin-top: 40px; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; }
th, td { text-align: left; padding: 4px 8px; border-bottom: 1px solid var(--grid);
  vertical-align: top; }
td.no { background: var(--bad); } .soft { color: var(--soft); }
svg { width: 100%; height: auto; display: block; margin: 8px 0; }
svg text { font: 12px system-ui, "DejaVu Sans", sans-serif; fill: var(--soft); }
svg .name { fill: var(--ink); } .films { display: flex; flex-wrap: wrap; gap: 4px; }
.films img { width: 156px; height: auto; }
"""
WIDTH, LEFT, RIGHT = 960, 62, 12
STATES = ("initializing", "tracking", "coasting", "vision only", "lost")


def number(value):
    """Short text of a coordinate."""
    return f"{value:.1f}".rstrip("0").rstrip(".")


def path(t, y, to_x, to_y):
    """SVG path of a series; a value that is not finite leaves a gap."""
    points, pen = [], "M"
    for a, b in zip(t, y):
        if not np.isfinite(b):
            pen = "M"
            continue
        points.append(f"{pen}{number(to_x(a))} {number(to_y(b))}")
        pen = "L"
    return "".join(points)


def ticks(low, high, count=4):
    """Round numbers between low and high."""
    step = 10 ** np.floor(np.log10(max(high - low, 1e-12) / count))
    for factor in (1, 2, 5, 10):
        if (high - low) / (step * factor) <= count + 0.5:
            step *= factor
            break
    values = np.arange(np.ceil(low / step), np.floor(high / step + 1e-6) + 1) * step
    return np.where(np.abs(values) < step * 1e-6, 0.0, values)  # no negative zero


def panel(top, height, name, span, lines, shades, axis):
    """A chart with its title; `lines` are (t, y, color, dash, label). Returns SVG."""
    values = np.concatenate([y[np.isfinite(y)] for _, y, *_ in lines] or [np.zeros(1)])
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    pad = 0.06 * (high - low) or 0.5
    low, high = low - pad, high + pad
    to_x = lambda t: LEFT + (t - span[0]) / (span[1] - span[0]) * (WIDTH - LEFT - RIGHT)
    to_y = lambda y: top + height - (y - low) / (high - low) * height
    out = [f'<rect x="{number(to_x(a))}" y="{top}" width="{number(to_x(b) - to_x(a))}" '
           f'height="{height}" fill="var(--shade)"/>' for a, b in shades]
    for value in ticks(low, high):
        y = number(to_y(value))
        out.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y}" y2="{y}" '
                   f'stroke="var(--grid)"/><text x="{LEFT - 6}" y="{number(to_y(value) + 4)}" '
                   f'text-anchor="end">{value:.6g}</text>')
    for t, y, color, dash, _ in lines:
        out.append(f'<path d="{path(t, y, to_x, to_y)}" fill="none" stroke="var(--{color})" '
                   f'stroke-width="1.6" stroke-dasharray="{dash}"/>')
    if axis:
        for value in ticks(*span, 10):
            out.append(f'<text x="{number(to_x(value))}" y="{top + height + 16}" '
                       f'text-anchor="middle">{value:.6g}</text>')
        out.append(f'<text x="{WIDTH - RIGHT}" y="{top + height + 32}" text-anchor="end">'
                   "time from the release, s</text>")
    # The legend stands in the title's line, from the right.
    x = WIDTH - RIGHT
    for _, _, color, dash, label in reversed(lines):
        x -= 7.0 * len(label)
        out.append(f'<text x="{x:.0f}" y="{top - 6}">{html.escape(label)}</text>'
                   f'<line x1="{x - 24:.0f}" x2="{x - 5:.0f}" y1="{top - 10}" y2="{top - 10}" '
                   f'stroke="var(--{color})" stroke-width="2" stroke-dasharray="{dash}"/>')
        x -= 36
    out.append(f'<text class="name" x="{LEFT}" y="{top - 6}">{html.escape(name)}</text>')
    return "".join(out)


def status_strip(top, span, columns, shades):
    """State of the estimate over time: a row per state that occurs, and one for `valid`."""
    to_x = lambda t: LEFT + (t - span[0]) / (span[1] - span[0]) * (WIDTH - LEFT - RIGHT)
    rows = [(STATES[k], columns["state"] == k, "third") for k in range(5)
            if np.any(columns["state"] == k)]
    rows.append(("not valid", columns["valid"] == 0, "volant"))
    out = [f'<rect x="{number(to_x(a))}" y="{top}" width="{number(to_x(b) - to_x(a))}" '
           f'height="{16 * len(rows)}" fill="var(--shade)"/>' for a, b in shades]
    for i, (name, on, color) in enumerate(rows):
        y = top + 16 * i
        out.append(f'<text x="{LEFT - 6}" y="{y + 12}" text-anchor="end" '
                   f'style="font-size:10px">{name}</text>')
        edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(int), [0]])))
        t = np.append(columns["t"], span[1])
        for begin, end in zip(edges[::2], edges[1::2]):
            if t[end] > span[0]:
                a, b = to_x(max(t[begin], span[0])), to_x(t[end])
                out.append(f'<rect x="{number(a)}" y="{y + 3}" width="{number(b - a)}" '
                           f'height="10" fill="var(--{color})"/>')
    return "".join(out), 16 * len(rows)


def chart(pair):
    """The figure of an episode: swing, position, commands, error, status."""
    truth, volant = (figures.series(record) for record in pair)
    record = pair[1]
    episode = record.episode
    span = (-0.5, episode.seconds)
    shades = [s for s in (episode.fault(), episode.push[:2]) if s]
    keep = lambda columns, name: (columns["t"], columns[name])

    def windowed(lines):
        return [(t[t >= span[0]], y[t >= span[0]], *rest) for t, y, *rest in lines]

    both = lambda name: windowed([
        (*keep(truth, name), "reference", "4 3", "feedback: truth"),
        (*keep(volant, name), "volant", "", "feedback: Volant")])
    goals = np.array(episode.goals)
    at = np.maximum(np.searchsorted(goals[:, 0], volant["t"], side="right") - 1, 0)
    out, top = [], 24
    panels = [("swing of the rope (truth), degrees", both("swing_deg"))]
    for axis, k in (("x", 1), ("y", 2)):
        panels.append((f"platform {axis}, m (feedback: Volant)", windowed([
            (volant["t"], goals[at, k], "axis", "2 3", "goal"),
            (*keep(volant, axis), "truth", "", "truth"),
            (*keep(volant, f"estimate_{axis}"), "volant", "5 4", "estimate")])))
    true = e.TruthLine(record)
    errors = e.errors(record, "odometry", true)
    length = 1e3 * np.linalg.norm(errors.position, axis=1)
    sigma = np.array([1e3 * m.position_sigma for _, m in record.received.get("status", [])])
    st = np.array([t for t, _ in record.received.get("status", [])])
    sigma[sigma > 200] = np.nan
    panels.append(("error of the estimated position, mm", windowed([
        (st, sigma, "axis", "2 3", "position_sigma of the status"),
        (errors.t, length, "volant", "", "error")])))
    panels += [("command: rail x, m/s", both("speed_x")), ("command: rail y, m/s", both("speed_y")),
               ("command: thrust x, N", both("force_x")), ("command: thrust y, N", both("force_y"))]
    for i, (name, lines) in enumerate(panels):
        out.append(panel(top, 92, name, span, lines, shades, i == len(panels) - 1))
        top += 92 + 30
    strip, height = status_strip(top + 12, span, volant, shades)
    out.append(strip)
    total = top + 12 + height + 8
    return (f'<svg viewBox="0 0 {WIDTH} {total}" role="img" aria-label="'
            f'{html.escape(episode.title)}: swing, position, error, commands and status over time">'
            + "".join(out) + "</svg>")


def film(record):
    """The crane from the side (along x) and from above, moving (SMIL), at half speed of the run.

    Solid: the truth; outline: the estimate.
    """
    columns = figures.series(record)
    keep = np.flatnonzero(columns["t"] >= 0)[::5]
    t = columns["t"][keep]
    scale, ground = 98.0, 322.0
    side = lambda y, z: (240 + scale * y, ground - scale * z)
    above = lambda x, y: (720 + scale * y, 165 + scale * x)
    seconds = 2 * (t[-1] - t[0])
    times = ";".join(f"{v:.4f}" for v in (t - t[0]) / (t[-1] - t[0]))

    def moving(attribute, values):
        text = ";".join(values)
        return (f'<animate attributeName="{attribute}" dur="{seconds:.2f}s" '
                f'repeatCount="indefinite" keyTimes="{times}" values="{text}"/>')

    def translated(points):
        text = ";".join(f"{number(a)} {number(b)}" for a, b in points)
        return (f'<animateTransform attributeName="transform" type="translate" '
                f'dur="{seconds:.2f}s" repeatCount="indefinite" keyTimes="{times}" '
                f'values="{text}"/>')

    get = lambda name: columns[name][keep]
    y, z, x = get("y"), get("z"), get("x")
    turn = get("turn")
    top_x = get("rail_x") - np.sin(turn) * c.CLIMBER_ATTACHMENT[1]
    top_y = get("rail_y") + np.cos(turn) * c.CLIMBER_ATTACHMENT[1]
    climber_side = [side(v, c.HEIGHT) for v in get("rail_y")]
    climber_above = [above(a, b) for a, b in zip(get("rail_x"), get("rail_y"))]
    low_side = [side(b, h) for b, h in zip(y, z)]
    low_above = [above(a, b) for a, b in zip(x, y)]
    hold = lambda values: np.where(np.isfinite(values), values, np.nan_to_num(values, nan=-9.0))
    guess = {axis: hold(get(f"estimate_{axis}")) for axis in "xyz"}
    estimate_side = [side(b, h) for b, h in zip(guess["y"], guess["z"])]
    estimate_above = [above(a, b) for a, b in zip(guess["x"], guess["y"])]
    rope = lambda ends, k: [number(p[k]) for p in ends]
    tops_side = [side(b, c.HEIGHT) for b in top_y]
    tops_above = [above(a, b) for a, b in zip(top_x, top_y)]
    rail = c.RAIL * scale
    goals = "".join(
        f'<circle cx="{number(above(g[1], g[2])[0])}" cy="{number(above(g[1], g[2])[1])}" r="4" '
        'fill="none" stroke="var(--reference)" stroke-width="2"/>' for g in record.episode.goals)

    def rope_line(begins, ends):
        return ('<line stroke="var(--rope)" stroke-width="2">'
                + moving("x1", rope(begins, 0)) + moving("y1", rope(begins, 1))
                + moving("x2", rope(ends, 0)) + moving("y2", rope(ends, 1)) + "</line>")

    climber = ('<rect x="-14" y="-12" width="28" height="12" fill="var(--body)">{}</rect>')
    body_side = '<rect x="-22" y="-3" width="44" height="8" fill="var(--body)">{}</rect>'
    body_above = '<rect x="-22" y="-22" width="44" height="44" fill="var(--body)">{}</rect>'
    ghost_side = ('<rect x="-24" y="-5" width="48" height="12" fill="none" '
                  'stroke="var(--volant)" stroke-width="2">{}</rect>')
    ghost_above = ('<rect x="-24" y="-24" width="48" height="48" fill="none" '
                   'stroke="var(--volant)" stroke-width="2">{}</rect>')
    return f"""<svg viewBox="0 0 {WIDTH} 350" role="img" aria-label="The crane in motion">
<text class="name" x="20" y="16">from the side (world y to the right)</text>
<text class="name" x="520" y="16">from above (world y to the right, x down)</text>
<line x1="{240 - rail}" x2="{240 + rail}" y1="{ground - scale * c.HEIGHT - 14}"
 y2="{ground - scale * c.HEIGHT - 14}" stroke="var(--axis)" stroke-width="3"/>
<line x1="60" x2="420" y1="{ground}" y2="{ground}" stroke="var(--grid)" stroke-width="2"/>
<rect x="{720 - rail}" y="{165 - rail}" width="{2 * rail}" height="{2 * rail}" fill="none"
 stroke="var(--axis)"/>{goals}
{rope_line(tops_side, low_side)}{climber.format(translated(climber_side))}
{body_side.format(translated(low_side))}{ghost_side.format(translated(estimate_side))}
{body_above.format(translated(low_above))}{ghost_above.format(translated(estimate_above))}
{rope_line(tops_above, low_above)}
<circle r="5" fill="var(--rope)">{translated(climber_above)}</circle>
<text x="20" y="345">gray: truth; red outline: estimate; blue circles: goals; half speed</text>
</svg>"""


def film_file(record):
    """The film as an SVG file of its own."""
    scheme = STYLE.split("body {")[0].replace(":root", "svg")
    text = "text { font: 12px sans-serif; fill: var(--soft); } .name { fill: var(--ink); }"
    return film(record).replace(
        '<svg viewBox', '<svg xmlns="http://www.w3.org/2000/svg" viewBox', 1).replace(
        ">", f"><style>{scheme}{text}</style>", 1)


def pictures(record):
    """What the climber's camera saw, at 2 Hz."""
    out = []
    for jpeg in record.film[:12]:
        small = io.BytesIO()
        Image.open(io.BytesIO(jpeg)).reduce(2).save(small, "JPEG", quality=70)
        data = base64.b64encode(small.getvalue()).decode()
        out.append('<img alt="image of the climber\'s camera" '
                   f'src="data:image/jpeg;base64,{data}">')
    return f'<div class="films">{"".join(out)}</div>'


def figure_table(rows):
    """The rows as HTML."""
    body = []
    for row in rows:
        verdict = {True: "holds", False: "does not hold", None: ""}[row.holds]
        kind = ' class="no"' if row.holds is False else ""
        cells = "".join(f"<td{kind}>{html.escape(text)}</td>"
                        for text in (row.what, row.required, row.measured, verdict))
        body.append(f"<tr>{cells}</tr>")
    return ("<table><thead><tr><th>what</th><th>required</th><th>measured</th><th></th></tr>"
            f"</thead><tbody>{''.join(body)}</tbody></table>")


def page(pairs, rows, gains, tried):
    """The whole page."""
    parts = [
        "<h1>Closed loop on third-party physics</h1>",
        "<p>A crane in MuJoCo, its camera rendered by MuJoCo, an Xsens MTx on a pseudo-terminal "
        "and encoders; the four nodes live over DDS; and <code>examples/swing_control</code>, "
        "which knows topics, tf and <code>volant/status</code>. Each episode ran with the truth as "
        "feedback and with Volant as feedback. Shaded: the fault or the push.</p>",
        figure_table(rows),
    ]
    factors = [v.wall["simulated"] / v.wall["total"] for _, v in pairs]
    if factors:
        slow = ("Where the machine was too slow, simulated time on /clock waited for the nodes "
                "(lock-step). " if min(factors) <= 0.97 else "")
        shares = {k: sum(v.wall[k] for _, v in pairs) / sum(v.wall["total"] for _, v in pairs)
                  for k in ("images", "physics", "waiting", "pace")}
        parts.append(
            f'<p class="soft">{slow}Real-time factor {min(factors):.2f} to {max(factors):.2f}; '
            f"rendering and JPEG took {shares['images']:.0%} of the time, physics "
            f"{shares['physics']:.0%}, waiting for nodes {shares['waiting']:.0%}, pacing "
            f"{shares['pace']:.0%}.</p>")
    restarted = [name for _, v in pairs for name in v.restarts]
    if restarted:
        parts.append(f'<p class="soft">Restarted because they did not find /clock within 6 s: '
                     f"{html.escape(', '.join(restarted))}.</p>")
    if tried:
        body = "".join(
            f"<tr><td>{'predicted' if p else 'present'} odometry</td><td>{gain}</td>"
            f"<td>{'stable' if holds else 'limit cycle'}</td></tr>" for p, gain, holds in tried)
        parts.append("<h2>Largest stable damping gain</h2><table><thead><tr><th>feedback</th>"
                     f"<th>gain, N s/m</th><th></th></tr></thead><tbody>{body}</tbody></table>")
    for pair in pairs:
        parts.append(f"<h2>{html.escape(pair[0].episode.title)}</h2>")
        parts.append(film(pair[1]))
        parts.append(chart(pair))
        parts.append(pictures(pair[1]))
    return ('<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width"><title>Volant: closed loop</title>'
            f"<style>{STYLE}</style></head><body>{''.join(parts)}</body></html>")


def write(name, pairs, rows, gains, tried):
    """Writes the report."""
    with open(name, "x", encoding="utf-8") as file:
        file.write(page(pairs, rows, gains, tried))
