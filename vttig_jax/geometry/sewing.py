"""Sewing of faces to a closed solid by Open CASCADE, and its STEP files."""
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# The bindings of Open CASCADE have no types and need the extra `cad`.

import math
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakeSolid,
    BRepBuilderAPI_MakeWire,
    BRepBuilderAPI_Sewing,
)
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepLib import BRepLib
from OCP.collections import Array1_double, Array1_gp_Pnt, Array1_int, Array2_gp_Pnt
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface
from OCP.gp import gp_Ax2, gp_Ax3, gp_Circ, gp_Cylinder, gp_Dir, gp_Pln, gp_Pnt
from OCP.GProp import GProp_GProps
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.Message import Message
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_StepModelType
from OCP.TCollection import TCollection_ExtendedString, TCollection_HAsciiString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS
from OCP.XCAFDoc import XCAFDoc_DocumentTool

from ..base.errors import InputError
from .patches import Patch

_SEWN_MM = 1e-6  # tolerance of sewing; chosen
_DEGENERATE_MM = 1e-7  # tolerance of degenerate edges; chosen
_VOLUME_ERROR = 1e-6  # relative error of the integration; chosen
_UP = gp_Dir(0.0, 0.0, 1.0)

Shape = Any
"""A `TopoDS_Shape`."""


def closed_solid(
    around: list[list[Patch]],
    cuts: list[list[Patch]],
    heights: tuple[float, ...],
    bore_radius: float,
    sector: tuple[float, float] | None,
    bores: list[Patch],
) -> Shape | None:
    """Sew faces to one valid solid with the material inside; return None if that fails.

    **Arguments**
    - `around`: surfaces of the teeth in each stretch, counter-clockwise.
    - `cuts`: first and last cut face of a sector in each stretch.
    - `heights`: limits of the stretches, mm.
    - `bore_radius`: radius of the bore, mm, 0 for no bore.
    - `sector`: angles from x, rad, between which the bore of a sector lies; None for a whole gear.
    - `bores`: surface of the bore in each stretch if it is not a cylinder between these angles;
      else empty.
    """
    sewing = BRepBuilderAPI_Sewing(_SEWN_MM)
    for row in (*around, *cuts, bores):
        for patch in row:
            sewing.Add(BRepBuilderAPI_MakeFace(_surface(patch), _DEGENERATE_MM).Face())
    whole = sector is None
    angles = (0.0, 2 * math.pi) if sector is None else sector
    # The cut faces of a sector end at each stretch, so the bore of a sector is divided likewise.
    ends = (heights[0], heights[-1]) if whole else heights
    if bore_radius > 0 and not bores:
        for low, high in pairwise(ends):
            axis = gp_Ax3(gp_Pnt(0.0, 0.0, 0.0), _UP, gp_Dir(1.0, 0.0, 0.0))
            cylinder = gp_Cylinder(axis, bore_radius)
            sewing.Add(BRepBuilderAPI_MakeFace(cylinder, *angles, low, high).Face())
    for end, z in ((0, heights[0]), (-1, heights[-1])):
        outline = [*cuts[end][:1], *around[end], *cuts[end][1:], *bores[end:][:1]]
        axis = gp_Ax2(gp_Pnt(0.0, 0.0, z), _UP, gp_Dir(1.0, 0.0, 0.0))
        bore = gp_Circ(axis, bore_radius) if bore_radius > 0 and not bores else None
        sewing.Add(_end_face(outline, end, z, bore, sector))
    sewing.Perform()
    shell = sewing.SewedShape()
    if shell.ShapeType() != TopAbs_ShapeEnum.TopAbs_SHELL:
        return None
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(shell)).Solid()
    if not BRepLib.OrientClosedSolid_s(solid) or not BRepCheck_Analyzer(solid).IsValid():
        return None
    return solid


def _end_face(
    outline: list[Patch],
    end: int,
    z: float,
    bore: gp_Circ | None,
    sector: tuple[float, float] | None,
) -> Shape:
    """Return the plane end face between the outline of the teeth and the bore."""
    wire = BRepBuilderAPI_MakeWire()
    for patch in outline:
        wire.Add(BRepBuilderAPI_MakeEdge(_end_curve(patch, end)).Edge())
    if bore is not None and sector is not None:
        wire.Add(BRepBuilderAPI_MakeEdge(bore, *sector).Edge())
    face = BRepBuilderAPI_MakeFace(gp_Pln(gp_Pnt(0.0, 0.0, z), _UP), wire.Wire(), True)
    if bore is not None and sector is None:
        hole = BRepBuilderAPI_MakeWire(BRepBuilderAPI_MakeEdge(bore).Edge()).Wire()
        face.Add(TopoDS.Wire(hole.Reversed()))
    return face.Face()


def _end_curve(patch: Patch, end: int) -> Geom_BSplineCurve:
    poles = patch.poles[end]
    points = _filled(Array1_gp_Pnt(1, len(poles)), (gp_Pnt(*map(float, pole)) for pole in poles))
    return Geom_BSplineCurve(points, *_knots(patch.knots[1]), patch.degree)


def _surface(patch: Patch) -> Geom_BSplineSurface:
    """Return the B-spline surface of a patch; its normal points out of the gear.

    The parameter U runs around the gear and V along the face.
    """
    poles = np.swapaxes(patch.poles, 0, 1)
    points = Array2_gp_Pnt(1, poles.shape[0], 1, poles.shape[1])
    for i, line in enumerate(poles):
        for j, pole in enumerate(line):
            points.SetValue(i + 1, j + 1, gp_Pnt(*map(float, pole)))
    (v, v_times), (u, u_times) = (_knots(knots) for knots in patch.knots)
    return Geom_BSplineSurface(points, u, v, u_times, v_times, patch.degree, 3)


def _knots(repeated: np.ndarray) -> tuple[Array1_double, Array1_int]:
    """Return the distinct knots and their multiplicities."""
    values, multiplicities = np.unique(repeated, return_counts=True)
    knots = _filled(Array1_double(1, len(values)), map(float, values))
    return knots, _filled(Array1_int(1, len(values)), map(int, multiplicities))


def _filled(array: Any, values: Iterable[Any]) -> Any:
    """Return an array of Open CASCADE, counted from 1, with these values."""
    for k, value in enumerate(values):
        array.SetValue(k + 1, value)
    return array


def volume(shape: Shape) -> float:
    """Return the volume of a closed solid, mm³."""
    properties = GProp_GProps()
    # Without the error argument the relative accuracy is only 2e-5.
    BRepGProp.VolumeProperties_s(shape, properties, _VOLUME_ERROR)
    return properties.Mass()


def faces_of(shape: Shape) -> list[Shape]:
    """Return all faces of a shape."""
    faces, explorer = [], TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        faces.append(TopoDS.Face(explorer.Current()))
        explorer.Next()
    return faces


def write_step(shape: Shape, path: Path, name: str) -> None:
    """Write STEP AP214 in mm; `name` is the product name in ASCII.

    **Raises** `InputError` if Open CASCADE cannot write the file.
    """
    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    label = XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).AddShape(shape, False)
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    writer = STEPCAFControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    Message.DefaultMessenger_s().ChangePrinters().Clear()  # no messages on stdout
    writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    header = APIHeaderSection_MakeHeader(writer.ChangeWriter().Model())
    empty = TCollection_HAsciiString("")
    header.SetName(TCollection_HAsciiString(name))
    header.SetAuthorValue(1, empty)
    header.SetOrganizationValue(1, empty)
    header.SetAuthorisation(empty)
    header.SetOriginatingSystem(TCollection_HAsciiString("vttig_jax"))
    if writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError("Open CASCADE could not write the solid.", where=str(path))
