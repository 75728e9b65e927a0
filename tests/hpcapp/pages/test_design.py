"""The design of the pages: words and marks can be told from what is behind them (WCAG 2, AA)."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

WORDS = 4.5  # the least contrast of words
MARKS = 3.0  # of edges, bars and dots

STYLE = files("hpcapp.pages").joinpath("static", "design.css").read_text(encoding="utf-8")
LIGHT, DARK = STYLE.split("@media (prefers-color-scheme: dark)")


def read_colours(style: str) -> dict[str, str]:
    return dict(re.findall(r"--([a-z0-9-]+): (#[0-9a-f]{6});", style))


THEMES = {
    "light": read_colours(LIGHT),
    "dark": read_colours(LIGHT) | read_colours(DARK),
}


def brightness(colour: str) -> float:
    """Return the relative luminance of a colour, as WCAG 2 defines it."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    dark, light = sorted([brightness(one), brightness(other)])
    return (light + 0.05) / (dark + 0.05)


def test_contrast_is_that_of_the_standard() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.005)


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("ground", ["paper", "panel"])
@pytest.mark.parametrize("word", ["ink", "soft", "accent", "warn", "bad", "good"])
def test_words_can_be_read(theme: str, ground: str, word: str) -> None:
    colours = THEMES[theme]
    assert contrast(colours[word], colours[ground]) >= WORDS


@pytest.mark.parametrize("theme", THEMES)
def test_a_pressed_button_can_be_read(theme: str) -> None:
    assert contrast(THEMES[theme]["paper"], THEMES[theme]["accent"]) >= WORDS


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("state", ["idle", "running", "done", "failed"])
def test_states_can_be_read(theme: str, state: str) -> None:
    assert contrast(THEMES[theme]["on-state"], THEMES[theme][state]) >= WORDS


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("ground", ["paper", "panel"])
@pytest.mark.parametrize("mark", ["edge", *(f"series-{n}" for n in range(1, 13))])
def test_marks_can_be_seen(theme: str, ground: str, mark: str) -> None:
    colours = THEMES[theme]
    assert contrast(colours[mark], colours[ground]) >= MARKS


def test_dark_has_its_own_of_all_that_light_shows_on_its_ground() -> None:
    states = {"on-state", "idle", "running", "done", "failed"}
    assert set(read_colours(DARK)) == set(read_colours(LIGHT)) - states


def test_no_series_has_the_colour_of_another_or_of_a_state() -> None:
    for colours in THEMES.values():
        shown = [c for name, c in colours.items() if name.startswith("series") or name in
                 ("idle", "running", "done", "failed")]  # fmt: skip
        assert len(set(shown)) == len(shown) == 16


def test_a_finger_has_40_pixels() -> None:
    [coarse] = re.findall(r"@media \(pointer: coarse\) \{ :root \{ --target: ([\d.]+)rem; \} \}",
                          STYLE)  # fmt: skip
    assert 16 * float(coarse) >= 40
    assert re.search(r"button, select[^{]*\{ min-height: var\(--target\)", STYLE)
