"""The statements of [Rahimi] that are judged: where the paper makes them, and its words."""

from __future__ import annotations

from occlog.papers.verdicts import OWN, PaperSource, Sources

SOURCES: Sources = {
    "fig3-start": PaperSource(
        "Sec. 6",
        "all unobserved trajectory points at the origin, all observed ones at one meter along the optical axis",
    ),
    "fig3-rays": PaperSource(
        "Fig. 3, Sec. 6", "In early iterations, the likelihood term lines up the trajectory points"
    ),
    "fig3-prior": PaperSource("Fig. 3, Sec. 6", "The prior pulls the trajectory towards the right distance"),
    "fig3-closer": PaperSource("Fig. 3, Sec. 6", "the estimated trajectory as it is refined"),
    "fig3-converges": PaperSource("Fig. 3, Sec. 6"),
    "fig3-iterations": PaperSource("Fig. 3", "iterations 0, 1, 3, 9, 11, and 17"),
    "fig4-close": PaperSource("Figs. 3 and 4, Sec. 6", "the estimated trajectory is close to the true trajectory"),
    "fig4-ends": PaperSource("Fig. 4", "the ends of the trajectories do not match up with the ground truth"),
    "fig4-beyond": PaperSource("Fig. 4", "For these points, velocity information can only come from past points"),
    "fig5-behind": PaperSource("Fig. 5", "the dynamics can pull the trajectories behind the cameras"),
    "fig5-front": PaperSource(
        "Eq. 9, Sec. 5", "every measurement emanated from a sensor that had the target in front of it"
    ),
    "fig5-no-worse": PaperSource("Fig. 5, Sec. 6"),
    "fig5-critical": PaperSource(
        "Fig. 5, Sec. 6", "The field of view constraints are critical in recovering the trajectories"
    ),
    "fig5-room": PaperSource("Sec. 8", "known obstacles in the environment can provide helpful information"),
    "fig7-depths": PaperSource(
        "Fig. 7, Sec. 7", "The forward and backward legs in this loop are correctly found to be at different depths"
    ),
    "fig7-loop": PaperSource("Fig. 7, Sec. 7", "the loop seen by camera 1 was successfully recovered"),
    "fig7-legs": PaperSource(
        "Fig. 7, Sec. 7", "The long legs towards and away from camera 3 are not correctly recovered"
    ),
    "fig7-through": PaperSource("Fig. 7, Sec. 7", "goes through a wall between camera 3 and 4"),
    "fig7-walls": PaperSource(
        "Fig. 7, Sec. 7",
        "Had we encoded these walls [...], the legs through camera 3 might have been correctly estimated",
    ),
    "fig1-scale": PaperSource(
        "Fig. 1a, Sec. 1", "location can only be determined up to a scale factor with a single camera"
    ),
    "fig1-speed": PaperSource("Fig. 1a, Sec. 1", "its location can be fully recovered by matching its speed"),
    "fig1-two": PaperSource("Fig. 1b, Sec. 1", "its trajectory can be estimated with two non-overlapping cameras"),
    "sec7-same-bearing": PaperSource(
        "Fig. 7, Sec. 7", "It was impossible [...] because the subject moved along the same bearing"
    ),
    "eq1": PaperSource("Eq. 1, Sec. 3", "adds the velocities in x_t to the positions in x_t"),
    "eq2": PaperSource("Eq. 2, Sec. 3", "where Lambda_X^-1 is tri-diagonal"),
    "eq3": PaperSource("Eq. 3, Sec. 3"),
    "eq3-inverse": OWN,
    "sec5-sparse": PaperSource("Sec. 5", "with exactly 2 non-zero elements in each row"),
    "false": OWN,
    "covariance": OWN,
}
