"""What a user should know of a pose: why it is refused, and what is doubtful about one that is not."""

import math

from lib.vision.refinement.pose import MOST

POOR_PX = 0.25  # rms; sharp photographs of an exact model stay at 0.06 to 0.15


def refusal(found, result, denied=(0, 0), most=1.0) -> str:
    """Why the photographs do not prove the pose, with the figures.

    found : Recognition;  result : Refined;  denied : facets that lie where the model shows something else, and those
    that say yes or no;  most : their share that is allowed
    """
    nats = f"{result.evidence:.0f} nats, {result.needed:.0f} needed"
    rivals = f", and {len(result.ambiguous)} other poses are not refuted" if result.ambiguous else ""
    against = ""
    if denied[0] > most * denied[1]:
        against = (
            f"; {denied[0]} of {denied[1]} facets lie where the model shows something else, at most "
            f"{100 * most:.0f} % may"
        )
    return (
        f"{found.why or 'a pose explains them'}, and the photographs show {math.floor(100 * result.support)} % of the "
        f"best pose's edges, {100 * result.least:.0f} % needed; {nats}{rivals}{against}"
    )


def warnings(found, result) -> list[tuple[str, str]]:
    """[(option that names the file, text)]."""
    said = []
    if result.rms_px and result.rms_px > POOR_PX:
        text = (
            f"the model's edges lie {result.rms_px:.2f} px rms from the photographs': lenses, relative pose or model "
            "are not exact, and the pose may be worse than its covariance says"
        )
        said.append(("photograph", text))
    if result.evidence < result.needed:
        text = (
            f"only {100 * result.support:.0f} % of the edges that the model predicts are found: the pose is poor, or "
            "the model is not what is seen"
        )
        said.append(("photograph", text))
    if result.status == "ambiguous":
        least = "at least " if len(found.poses) > MOST else ""
        others = f"{least}{len(result.ambiguous)} other poses explain the facets as well: see ambiguous in pose.json"
        said.append(("model", others))
    return said
