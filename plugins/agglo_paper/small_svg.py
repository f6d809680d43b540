"""Compression of SVG drawings by matplotlib: fewer decimals, shared styles, images with few colours."""

from __future__ import annotations

import base64
import re
from collections import Counter
from io import BytesIO

_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_TAG = re.compile(r"<[a-z][^<>]*>")  # numbers between tags are axis labels
_SPACES = re.compile(r"\n\s+|(?<=[a-zA-Z0-9]) \n")
_PICTURE = re.compile(r"(data:image/png;base64,)([^\"]+)")
_STYLE = re.compile(r'style="([^"]+)"')
_CLIPPED = re.compile(r'(<g clip-path="url\(#\w+\)">)((?:(?!</?g\b).)*)</g>', re.DOTALL)
_POLYLINES = re.compile(r'( d=")((?:[ML] -?[\d.]+ -?[\d.]+\s+|z\s+)+)"')
_HASH = re.compile(r"\b(?:[mp]|[A-Z][0-9a-f]{1,2}_[0-9a-f]{1,2}_)[0-9a-f]{10}\b")
_DOTS = re.compile(r'(<g clip-path="url\(#\w+\)")>((?:\n<use [^>]*/>)+\n)</g>')
_PLACE = re.compile(r'(?<= [xy]=")-?\d+\.\d\d(?=")')
_COLOURS = 20
_MANY = 30
_OFTEN = 20


def compress_svg(svg: str) -> str:
    """Compress an SVG drawing, with coordinates to within 0.06 points, and images in up to 20 colours.

    A compressed drawing stays unchanged.
    """
    # 1. Set images aside, with fewer colours
    pictures: list[str] = []

    def keep(match: re.Match[str]) -> str:
        pictures.append(match[1] + _few_colours(match[2]))
        return f"kept picture {len(pictures) - 1};"

    # 2. Round numbers, and shorten polylines and positions
    text = _TAG.sub(lambda tag: _NUMBER.sub(_hundredths, tag[0]), _PICTURE.sub(keep, svg))
    text = _POLYLINES.sub(_steps, _SPACES.sub("\n", text))
    text = _PLACE.sub(lambda match: f"{float(match[0]):.1f}", text)
    # 3. Share clips, names and styles
    text = _share_styles(_short_names(_join_clips(text)))
    return re.sub(r"kept picture (\d+);", lambda match: pictures[int(match[1])], text)


def _hundredths(found: re.Match[str]) -> str:
    return f"{round(float(found[0]), 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def _steps(match: re.Match[str]) -> str:
    """Write long polylines with relative coordinates, rounded to a tenth of a point."""
    words = match[2].split()
    if len(words) < _MANY:
        return match[0]
    short, at, first, place = "", (0, 0), (0, 0), 0
    while place < len(words):
        letter = words[place].lower()
        if letter == "z":
            short, at, place = short + "z", first, place + 1
            continue
        point = round(10 * float(words[place + 1])), round(10 * float(words[place + 2]))
        dx, dy = (_tenths(now - before) for now, before in zip(point, at, strict=True))
        if letter == "l":  # no letter needed after a move or a line
            short += _separate_number(dx) + _separate_number(dy)
        elif point != at or short[-1:] in ("", "z"):  # skip moves to the current point
            short += "m" + dx + _separate_number(dy)
        at, first, place = point, point if letter == "m" else first, place + 3
    return f'{match[1]}{short}"'


def _separate_number(number: str) -> str:
    return number if number.startswith("-") else f" {number}"


def _tenths(count: int) -> str:
    return f"{count / 10:g}".replace("0.", ".", 1) if abs(count) < 10 else f"{count / 10:g}"


def _short_names(svg: str) -> str:
    """Replace hash values used as names by short names, numbered by first occurrence."""
    names = {name: f"n{place:x}" for place, name in enumerate(dict.fromkeys(_HASH.findall(svg)))}
    return _HASH.sub(lambda found: names[found[0]], svg)


def _few_colours(encoded: str) -> str:
    """Reduce an image to a palette of 20 colours, if this makes its PNG file smaller."""
    from PIL import Image

    before = base64.b64decode(encoded)
    picture = Image.open(BytesIO(before))
    if picture.mode == "P":
        return encoded
    after = BytesIO()
    few = picture.convert("RGBA").quantize(_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(after, format="PNG", optimize=True)
    return base64.b64encode(min(before, after.getvalue(), key=len)).decode()


def _join_clips(svg: str) -> str:
    """Join adjacent groups that have the same clip path."""
    lines: list[str] = []
    last = ""
    for piece in re.split(r"(?=<g clip-path)", svg):
        match = _CLIPPED.match(piece)
        if match and match[1] == last and lines[-1].endswith("</g>\n"):
            lines[-1] = lines[-1].removesuffix("</g>\n") + piece.removeprefix(match[1] + "\n")
        else:
            lines.append(piece)
        last = match[1] if match and match.end() == len(piece.rstrip("\n")) else ""
    return "".join(lines)


def _share_look(dots: re.Match[str]) -> str:
    """Move the style of markers to their group, if all are equal."""
    looks = set(re.findall(r' class="\w+"', dots[2]))
    if len(looks) != 1 or dots[2].count(" class=") != dots[2].count("<use"):
        return dots[0]
    look = looks.pop()
    return f"{dots[1]}{look}>{dots[2].replace(look, '')}</g>"


def _share_styles(svg: str) -> str:
    """Replace frequent style attributes by style classes defined at the beginning."""
    counted = Counter(_STYLE.findall(svg))
    names = {
        style: f"s{place}" for place, (style, often) in enumerate(counted.most_common()) if often >= _OFTEN
    }
    if not names:
        return svg
    rules = "".join(f".{name}{{{style}}}" for style, name in names.items())
    short = _STYLE.sub(lambda found: f'class="{names[found[1]]}"' if found[1] in names else found[0], svg)
    short = _DOTS.sub(_share_look, short)
    return short.replace("<defs>", f"<defs>\n<style>{rules}</style>", 1)
