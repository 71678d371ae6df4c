"""What a user should know of further photographs."""

from lib.vision.refinement.pose import LEAST
from lib.vision.refinement.words import POOR_PX

NOT_USED = "posed, and not used for the materials yet"


def warnings(picture, place, shown) -> list[str]:
    """picture : files.Picture;  place : locate.Place of one that had no pose;  shown : session.Shown of one that had"""
    if place is not None and place.camera is None:
        return [f"{picture.path}: pose: not found: {place.why}"]
    if shown is not None and not shown.is_believed:
        return [
            f"{picture.path}: pose: given, but the photograph shows {shown.share:.0%} of the model's edges there, "
            f"{LEAST:.0%} needed: the pose or the model is wrong, and it is not used"
        ]
    said = [f"{picture.path}: {NOT_USED}"]
    if place is not None and place.rms_px and place.rms_px > POOR_PX:
        said.append(
            f"{picture.path}: the model's edges lie {place.rms_px:.2f} px rms from the photograph's: the lens or the "
            "model is not exact, and the pose may be worse than its covariance says"
        )
    return said
