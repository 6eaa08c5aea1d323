"""The colours. Colours with a meaning are distinguishable with colour blindness and always accompanied by text.

M. Okabe and K. Ito, Color Universal Design, 2008: bluish green, orange, vermillion, sky blue, yellow, reddish purple.
"""

from __future__ import annotations

from dataclasses import dataclass

from lanebound.envs.rendering.config import ThemeName

__all__ = ["THEMES", "Colour", "Theme", "mix"]

Colour = tuple[int, int, int]

GREEN, ORANGE, VERMILLION = (0, 158, 115), (230, 159, 0), (213, 94, 0)
SKY_BLUE, PURPLE = (86, 180, 233), (204, 121, 167)


@dataclass(frozen=True)
class Theme:
    """Colours by meaning: ``ok``, ``caution`` and ``alert`` are those of the status."""

    ground: Colour
    kerb: Colour
    road: Colour
    marking: Colour
    building_low: Colour
    building_high: Colour
    building_edge: Colour
    shadow: Colour
    tree: Colour
    overhead: Colour
    panel: Colour
    plot: Colour
    grid: Colour
    text: Colour
    muted: Colour
    ego: Colour
    ego_belief: Colour
    other: Colour
    other_belief: Colour
    crashed: Colour
    glass: Colour
    limit: Colour
    ok: Colour = GREEN
    caution: Colour = ORANGE
    alert: Colour = VERMILLION


THEMES = {
    ThemeName.DARK: Theme(
        ground=(27, 32, 38), kerb=(72, 79, 88), road=(50, 56, 64), marking=(196, 202, 208), building_low=(62, 70, 82),
        building_high=(104, 114, 130), building_edge=(122, 132, 148), shadow=(17, 20, 25), tree=(70, 134, 88),
        overhead=(120, 128, 140), panel=(19, 23, 28), plot=(30, 36, 43), grid=(60, 68, 78), text=(232, 236, 240),
        muted=(150, 159, 169), ego=SKY_BLUE, ego_belief=(255, 255, 255), other=(146, 154, 166),
        other_belief=(240, 228, 66), crashed=PURPLE, glass=(24, 30, 38), limit=(190, 164, 255),
        ok=(22, 178, 132), caution=(236, 170, 20), alert=(228, 96, 20),
    ),
    ThemeName.LIGHT: Theme(
        ground=(238, 240, 236), kerb=(176, 180, 184), road=(206, 210, 214), marking=(255, 255, 255),
        building_low=(196, 190, 182), building_high=(150, 146, 142), building_edge=(126, 120, 114),
        shadow=(216, 216, 210), tree=(112, 170, 112), overhead=(120, 124, 130), panel=(240, 242, 244),
        plot=(255, 255, 255), grid=(218, 222, 226), text=(28, 32, 38), muted=(102, 110, 120), ego=(0, 114, 178),
        ego_belief=(10, 14, 20), other=(120, 128, 138), other_belief=(150, 92, 0), crashed=(170, 60, 120),
        glass=(40, 46, 54), limit=(104, 66, 190), ok=(0, 138, 100), caution=(214, 140, 0),
    ),
}  # fmt: skip


def mix(a: Colour, b: Colour, share: float) -> Colour:
    """Interpolate between colours ``a`` (share 0) and ``b`` (share 1); the share is clamped to [0, 1]."""
    s = min(max(share, 0.0), 1.0)
    return (round(a[0] + s * (b[0] - a[0])), round(a[1] + s * (b[1] - a[1])), round(a[2] + s * (b[2] - a[2])))
