"""The fixtures of usd-core beside this file: python tests/data/writers/usd-core/make.py

One small room in all that composition has: a referenced class, variants, a payload, an instancer, instances, subsets,
samples of time. Written as text, as a crate and as a package.
"""

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdUtils

HERE = Path(__file__).parent
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def mesh(stage, path, material=None, points=SQUARE):
    made = UsdGeom.Mesh.Define(stage, path)
    made.CreatePointsAttr(points)
    made.CreateFaceVertexCountsAttr([3, 3])
    made.CreateFaceVertexIndicesAttr([0, 1, 2, 0, 2, 3])
    made.CreateSubdivisionSchemeAttr("none")
    if material:
        UsdShade.MaterialBindingAPI.Apply(made.GetPrim()).Bind(material)
    return made


def main():
    stage = Usd.Stage.CreateNew(str(HERE / "room.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Room").GetPrim())
    wood, wall = (UsdShade.Material.Define(stage, f"/Room/Looks/{name}") for name in ("Wood", "Wall"))
    glow = UsdShade.Shader.Define(stage, "/Room/Looks/Wall/Surface")
    glow.CreateIdAttr("UsdPreviewSurface")
    glow.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f).Set((1, 0.5, 0))
    floor = mesh(stage, "/Room/Floor", wood, [(400 * x, 300 * y, z) for x, y, z in SQUARE])
    half = UsdShade.MaterialBindingAPI(floor).CreateMaterialBindSubset("half", [1])
    UsdShade.MaterialBindingAPI.Apply(half.GetPrim()).Bind(wall)
    stage.CreateClassPrim("/Chair")
    mesh(stage, "/Chair/Seat", None, [(40 * x, 40 * y, 45) for x, y, z in SQUARE])
    for k in range(3):
        chair = UsdGeom.Xform.Define(stage, f"/Room/Chair{k}")
        chair.AddTranslateOp().Set(Gf.Vec3d(100 * k, 50, 0), 1.0 + k)
        chair.GetPrim().GetReferences().AddInternalReference("/Chair")
        chair.GetPrim().SetInstanceable(k > 0)
    variants = stage.GetPrimAtPath("/Room").GetVariantSets().AddVariantSet("time")
    for name in ("day", "night"):
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        with variants.GetVariantEditContext():
            mesh(stage, f"/Room/{name}", wall, [(x, y, z + 250) for x, y, z in SQUARE])
    cups = UsdGeom.PointInstancer.Define(stage, "/Room/Cups")
    mesh(stage, "/Room/Cups/Cup", wood)
    cups.CreatePrototypesRel().AddTarget("/Room/Cups/Cup")
    cups.CreateProtoIndicesAttr([0, 0, 0])
    cups.CreatePositionsAttr([(10, 20, 70), (30, 20, 70), (50, 20, 70)])
    cups.CreateOrientationsAttr([Gf.Quath(1, 0, 0, 0), Gf.Quath(0, 0, 0, 1), Gf.Quath(0, 1, 0, 0)])
    cups.CreateScalesAttr([(1, 1, 1), (2, 2, 2), (1, 1, -1)])
    cups.CreateInvisibleIdsAttr([0])
    UsdGeom.Cube.Define(stage, "/Room/Box").CreateSizeAttr(30)
    UsdLux.SphereLight.Define(stage, "/Room/Bulb")
    stage.Save()
    stage.GetRootLayer().Export(str(HERE / "room.usdc"))
    UsdUtils.CreateNewUsdzPackage(str(HERE / "room.usda"), str(HERE / "room.usdz"))


if __name__ == "__main__":
    main()
