"""What a file is that is not what its name says, in words: the first bytes tell."""

POINTER = b"version https://git-lfs"
MARKS = {
    b"ply\n": "a PLY file",
    b"ply\r": "a PLY file",
    b"Kaydara FBX": "an FBX file",
    b"BLENDER": "a file of Blender",
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "a gzip archive",
    b"%PDF": "a PDF",
    b"#usda": "a USD file",
    b"PXR-USDC": "a USD file",
    b"glTF": "a GLB file",
}
CONVERTED = ("a PLY file", "an STL file", "a glTF file", "a Mitsuba scene", "a USD file")  # by new-scene


def kind_of(content: bytes) -> str | None:
    """Words for what a file is, by its first bytes and its length; None where nothing is recognised.

    >>> kind_of(b"<!DOCTYPE html><p>"), kind_of(b"v 0 0 0")
    ('a web page', None)
    """
    head = content[:1000]
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if head.startswith(POINTER):
        return "a pointer of Git LFS"
    if start[:9].lower().startswith((b"<!doctype", b"<html")):
        return "a web page"
    for mark, words in MARKS.items():
        if head.startswith(mark):
            return words
    if len(content) >= 84 and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little"):
        return "an STL file"
    if start.startswith(b"solid") and b"facet" in head:
        return "an STL file"
    if start.startswith(b"{") and b'"asset"' in content:
        return "a glTF file"
    if start.startswith(b"<") and b"<scene" in head:
        return "a Mitsuba scene"
    return None


def way_out(kind) -> str:
    """What to do about a model of that kind."""
    if kind == "a pointer of Git LFS":
        return "git lfs pull fetches the file"
    if kind in CONVERTED:
        return "make new-scene MODEL=... converts it"
    if kind == "a GLB file":
        return "rename it to model.glb"
    return "export it as OBJ or GLB, with its materials"
