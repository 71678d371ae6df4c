"""What a file is that is not what its name says, in words: the first bytes tell."""

import struct

POINTER = b"version https://git-lfs"
MARKS = {
    b"ply\n": "a PLY file",
    b"ply\r": "a PLY file",
    b"Kaydara FBX": "an FBX file",
    b"; FBX": "an FBX file",
    b"BLENDER": "a file of Blender",
    b"\x28\xb5\x2f\xfd": "a zstd archive (or a compressed file of Blender)",
    b"\x1f\x8b": "a gzip archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"%PDF": "a PDF",
    b"#usda": "a USD file",
    b"PXR-USDC": "a USD file",
    b"glTF": "a GLB file",
    b"ISO-10303-21": "a STEP file",
    b"#VRML": "a VRML file",
    b"#X3D": "an X3D file",
    b"\xff\xfe\xff\x0eS\0k\0e\0t\0c\0h\0U\0p": "a SketchUp file",
    b"3D Geometry File Format": "a Rhino file (.3dm)",
    b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": "an OLE file (.max of 3ds Max, or of another program)",
    b"Ogawa": "an Alembic file",
    b"\x89HDF": "an HDF5 file (an older Alembic file, or data)",
    b"DRACO": "a Draco file",
    b"AC10": "a DWG file",
    b"//Maya ASCII": "a file of Maya",
    b"FOR4": "a file of Maya",
    b"FOR8": "a file of Maya",
    b"QC4DC4D6": "a file of Cinema 4D",
    b"# vtk DataFile": "a VTK file",
    b"# .PCD": "a point cloud (PCD)",
    b"AC3D": "an AC3D file",
    b"xof ": "a DirectX file (.x)",
    b"*3DSMAX_ASCIIEXPORT": "an ASE file of 3ds Max",
    b"$MeshFormat": "a mesh of Gmsh",
    b"MeshVersionFormatted": "a mesh of Medit",
    b"HIERARCHY": "a skeleton (BVH)",
    b"\xfd7zXZ": "an xz archive",
    b"BZh": "a bzip2 archive",
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"II*\0": "a picture (TIFF)",
    b"MM\0*": "a picture (TIFF)",
    b"\x76\x2f\x31\x01": "a picture (EXR)",
    b"LASF": "a point cloud (LAS)",
    b"ASTM-E57": "a point cloud (E57)",
    b"SQLite format 3": "a database",
}
OFF = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF")  # on a line of its own, or before the counts
# The first element of an XML file that is a model.
ELEMENTS = {
    b"<scene": "a Mitsuba scene",
    b"<collada": "a COLLADA file (.dae)",
    b"<x3d": "an X3D file",
    b"<kml": "a KML file",
    b"<amf": "an AMF file",
    b"<vtkfile": "a VTK file",
    b"<model": "a part of a 3MF file",
    b"<ifcxml": "an IFC file",
    b"<materialx": "a MaterialX file, which has no faces",
}
IN_ZIP = {  # a name in a ZIP archive, near its beginning or in the list at its end
    b"3D/3dmodel.model": "a 3MF file",
    b"3dmodel.model": "a 3MF file",
    b"doc.kml": "a KMZ file",
    b".fcstd": "a FreeCAD file",
    b"Document.xml": "a FreeCAD file",
    b".skp": "a SketchUp file",
}
CONVERTED = ("a PLY file", "an STL file", "a glTF file", "a Mitsuba scene", "a USD file")  # by new-scene
ARCHIVES = ("a gzip archive", "a ZIP archive", "a 7z archive", "a RAR archive", "an xz archive", "a bzip2 archive")
CAD = (
    "a STEP file",
    "an IFC file",
    "an IGES file",
    "a Rhino file (.3dm)",
    "a FreeCAD file",
    "a DWG file",
    "a DXF file",
)
SPARE = 512  # bytes behind the end of an STL file that is told by its count
SMALLEST, LARGEST = 1e-20, 1e15  # numbers of its first triangle, but for 0: other bytes would make wild ones


def kind_of(content: bytes) -> str | None:
    """Words for what a file is, by its first bytes and its length; None where nothing is recognised.

    >>> kind_of(b"<!DOCTYPE html><p>"), kind_of(b"v 0 0 0")
    ('a web page', None)
    """
    head = content[:4096]
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if head.startswith(POINTER):
        return "a pointer of Git LFS"
    if start[:9].lower().startswith((b"<!doctype", b"<html")) and b"<x3d" not in head.lower():
        return "a web page"
    for mark, words in MARKS.items():
        if head.startswith(mark):
            return "an IFC file" if words == "a STEP file" and b"IFC" in head else words
    if head.startswith(b"PK\x03\x04"):
        return next((words for mark, words in IN_ZIP.items() if mark in head + content[-4096:]), "a ZIP archive")
    if content[:2] == b"MM" and int.from_bytes(content[2:6], "little") == len(content):
        return "a 3DS file"
    if content[:4] == b"FORM" and content[8:12] in (b"LWO2", b"LWO3", b"LWOB"):
        return "a LightWave file"
    return "an STL file" if is_binary_stl(content) else _of_text(content, head, start)


def is_binary_stl(content) -> bool:
    """Whether the count of triangles behind the first 80 bytes is that of the file; few bytes may stand behind."""
    if len(content) < 84:
        return False
    count = int.from_bytes(content[80:84], "little")
    spare = len(content) - 84 - 50 * count
    if not count or not 0 < spare <= SPARE:
        return spare == 0
    return all(v == 0 or SMALLEST < abs(v) < LARGEST for v in struct.unpack_from("<12f", content, 84))


def _of_text(content, head, start):
    words = start[:200].split(None, 1)
    first = words[0] if words else b""
    if start[:5].lower() == b"solid" and b"facet" in head.lower():
        return "an STL file"
    if start.startswith(b"{") and b'"asset"' in content:
        return "a glTF file"
    if start.startswith(b"<"):
        small = head.lower()
        found = [(small.index(mark), kind) for mark, kind in ELEMENTS.items() if mark in small]
        return min(found)[1] if found else None
    if start.startswith(b"{") and b'"metadata"' in head:
        return "a JSON file of three.js"
    if b"WorldBegin" in head or first in (b"LookAt", b"Camera") and b"Film" in head:
        return "a scene of pbrt"
    if first in OFF or (first[:3] == b"OFF" and first[3:].isdigit()):
        return "an OFF file"
    if first in (b"0", b"999") and b"SECTION" in head:
        return "a DXF file"
    if len(head) > 80 and head[72:73] == b"S" and head[73:80].strip().isdigit():
        return "an IGES file"
    return None


def way_out(kind) -> str:
    """What to do about a model of that kind."""
    if kind == "a pointer of Git LFS":
        return "git lfs pull fetches the file"
    if kind in CONVERTED:
        return "make new-scene MODEL=... converts it"
    if kind == "a GLB file":
        return "rename it to model.glb"
    if kind in ARCHIVES:
        return "unpack it, and export it as OBJ or GLB, with its materials"
    if kind in CAD:
        return "open it in FreeCAD or its own program, and export it as OBJ or GLB, with its materials"
    if kind and kind.startswith("a picture"):
        return "give it as PHOTO, and the 3D model as MODEL"
    if kind and kind.startswith("a point cloud"):
        return "make a mesh of it, or draw the surfaces"
    return "export it as OBJ or GLB, with its materials"
