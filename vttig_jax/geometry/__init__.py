"""Gear geometry: tooth surfaces, measures of a gear, backlash and contact of a pair, solids."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .backlash.drawn_backlash import geometric_backlash as geometric_backlash
    from .backlash.drawn_backlash import section_backlash as section_backlash
    from .backlash.inverse import axial_for_backlash as axial_for_backlash
    from .backlash.report import gap_report as gap_report
    from .contact.contact_model import contact_model as contact_model
    from .contact.deviations import Deviations as Deviations
    from .contact.deviations import FlankMap as FlankMap
    from .contact.deviations_file import read_deviations as read_deviations
    from .contact.report import contact_at as contact_at
    from .measures.comparison import compare_stated as compare_stated
    from .measures.gear_measures import measure_gear as measure_gear
    from .measures.over_balls import over_balls as over_balls
    from .measures.span import span as span
    from .mounting import Misalignment as Misalignment
    from .solids.mesh import gear_mesh as gear_mesh
    from .solids.section_drawing import section_drawing as section_drawing
    from .solids.solid import gear_solid as gear_solid
    from .tooth.curvature import surface_curvatures as surface_curvatures
    from .tooth.fillet_interference import fillet_interference as fillet_interference
    from .tooth.form_circle import form_radius as form_radius
    from .tooth.form_circle import undercut_depth as undercut_depth
    from .tooth.recession import Tabulated as Tabulated
    from .tooth.roll_limits import fillet_span as fillet_span
    from .tooth.roll_limits import flank_roll as flank_roll
    from .tooth.roll_limits import flank_span as flank_span
    from .tooth.section_outline import tooth_section as tooth_section
    from .tooth.section_report import section_report as section_report
    from .tooth.surface import surface_normal as surface_normal
    from .tooth.surface import tooth_surface as tooth_surface
    from .tooth.tooth import Tooth as Tooth
    from .tooth.tooth import tooth_of as tooth_of
    from .tooth.validation import check_tooth as check_tooth

_HOMES = {
    "Deviations": "contact.deviations",
    "FlankMap": "contact.deviations",
    "Misalignment": "mounting",
    "Tabulated": "tooth.recession",
    "Tooth": "tooth.tooth",
    "axial_for_backlash": "backlash.inverse",
    "check_tooth": "tooth.validation",
    "compare_stated": "measures.comparison",
    "contact_at": "contact.report",
    "contact_model": "contact.contact_model",
    "fillet_interference": "tooth.fillet_interference",
    "fillet_span": "tooth.roll_limits",
    "flank_roll": "tooth.roll_limits",
    "flank_span": "tooth.roll_limits",
    "form_radius": "tooth.form_circle",
    "gap_report": "backlash.report",
    "gear_mesh": "solids.mesh",
    "gear_solid": "solids.solid",
    "geometric_backlash": "backlash.drawn_backlash",
    "measure_gear": "measures.gear_measures",
    "over_balls": "measures.over_balls",
    "read_deviations": "contact.deviations_file",
    "section_backlash": "backlash.drawn_backlash",
    "section_drawing": "solids.section_drawing",
    "section_report": "tooth.section_report",
    "span": "measures.span",
    "surface_curvatures": "tooth.curvature",
    "surface_normal": "tooth.surface",
    "tooth_of": "tooth.tooth",
    "tooth_section": "tooth.section_outline",
    "tooth_surface": "tooth.surface",
    "undercut_depth": "tooth.form_circle",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]
