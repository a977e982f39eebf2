"""What ``ladar_volume filter`` filters with, from its command line alone."""

from __future__ import annotations

import argparse

from ladar_volume.clouds.published.filter_presets import preset_keys
from ladar_volume.io.config import override
from ladar_volume.model.cloud_filter_parameters import FILTERS, ORDERS, FilterParameters
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameter import read_section


def order_of(parameters: FilterParameters) -> str:
    """The order whose filter has these parameters."""
    return next(order for order, kind in FILTERS.items() if type(parameters) is kind)


def settings(arguments: argparse.Namespace) -> tuple[FilterParameters, bool]:
    """Filter parameters, and whether radius, degree and threshold come from the cloud: preset <
    --radius, --degree < --set.

    Raises ConfigurationError for options that contradict each other.
    """
    keys = [text.partition("=")[0].strip() for text in arguments.set]
    for key in keys:
        if not key.startswith("filter."):
            raise ConfigurationError(
                f"--set {key}: this verb has parameters of the section 'filter' only", value=key
            )
    given = {
        key: value
        for key, value in (("radius_m", arguments.radius), ("degree", arguments.degree))
        if value is not None
    }
    by_hand = "radius_m" in given or arguments.preset is not None or "filter.radius_m" in keys
    if arguments.auto and by_hand:
        raise ConfigurationError(
            "--auto estimates what --radius, --preset or filter.radius_m give: choose one"
        )
    if not by_hand and ("degree" in given or "filter.degree" in keys):
        raise ConfigurationError(
            "the degree is estimated with the radius: give --radius too, or leave both to --auto"
        )
    overrides = dict(override(text)["filter"].popitem() for text in arguments.set)
    order = checked_order(overrides.pop("order", ORDERS[0]))
    if not by_hand and "outlier_sigmas" in overrides:
        raise ConfigurationError(
            "the threshold is estimated with the radius: give --radius too, or leave both to --auto"
        )
    chosen = {} if arguments.preset is None else preset_keys(arguments.preset, order)
    return read_section(FILTERS[order], "filter", {**chosen, **given, **overrides}), not by_hand


def checked_order(order: object) -> str:
    """One of ``ORDERS``."""
    if order not in ORDERS:
        raise ConfigurationError(
            f"filter.order: {order!r} is not allowed (allowed: one of {', '.join(ORDERS)})",
            value=order,
        )
    return str(order)
