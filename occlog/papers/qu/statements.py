"""The statements of [Qu] that are judged: where the paper makes them, and its words."""

from __future__ import annotations

from occlog.papers.verdicts import OWN, PaperSource, Sources

MUCH_LOWER = "BMCT outperforms the other approaches with much lower false position and label rates"
LINEARLY = "both the required number of particles and the speed of the proposed BMCT vary linearly"
EXPONENTIALLY = "increases exponentially in terms of the number of targets and cameras"
STABLE = "using more particles will increase the stability of the tracking performance"
DIFFERENT = (
    "superior performance of the proposed algorithm in both efficiency and robustness for multiple-target tracking in "
    "different conditions"
)
DIRECTION = "due to the absence of distinct inertia directions, the blind magnetic repulsion separates them"
WRONG_TARGETS = "the trackers may attach to wrong targets, and thus lose the correct target"
CLUTTER = "Background subtraction is used to decrease the clutter and enhance the performance"

SOURCES: Sources = {
    "sweeps": PaperSource("Sec. 3.2", "we iterate several times (usually twice is enough) between different views"),
    "table1-collaboration": PaperSource(
        "Table 1, Sec. 4.4.1", "the computational cost required for camera collaboration is negligible"
    ),
    "table1-interaction": PaperSource("Table 1, Sec. 4.4.1"),
    "table1-order": PaperSource("Table 1, Sec. 4.4.1"),
    "table2-bmct": PaperSource("Table 2, Sec. 4.4.1", LINEARLY),
    "table2-mcmc": PaperSource("Table 2, Sec. 4.4.1", EXPONENTIALLY),
    "table2-mcmc-4": PaperSource("Table 2"),
    "table2-mcmc-5": PaperSource("Table 2"),
    "table2-mcmc-6": PaperSource("Table 2"),
    "table2-sir": PaperSource("Sec. 4.4.1", EXPONENTIALLY),
    "table2-rates": PaperSource("Table 2"),
    "table2-rates-bmct-growth": PaperSource("Table 2, Sec. 4.4.1", LINEARLY),
    "table2-rates-mcmc-growth": PaperSource("Table 2, Sec. 4.4.1", EXPONENTIALLY),
    "table2-rates-bmct-stable": PaperSource("Sec. 4.4.3", STABLE),
    "table2-rates-mcmc-stable": PaperSource("Sec. 4.4.3", STABLE),
    "table2-faster": PaperSource("Table 2"),
    "table3-fr_p": PaperSource("Table 3, Sec. 4.4.2"),
    "table3-fr_l": PaperSource("Table 3, Sec. 4.4.2"),
    "table3-fr_p-much-lower": PaperSource("Table 3, Sec. 4.4.2", MUCH_LOWER),
    "table3-fr_l-much-lower": PaperSource("Table 3, Sec. 4.4.2", MUCH_LOWER),
    "table3-fr_p-bmct-idmot": PaperSource("Table 3, Sec. 4.4.2", MUCH_LOWER),
    "table3-fr_l-bmct-idmot": PaperSource("Table 3, Sec. 4.4.2", MUCH_LOWER),
    "table3-fr_p-mean": OWN,
    "table3-fr_p-median": OWN,
    "table3-fr_l-mean": OWN,
    "table3-fr_l-median": OWN,
    "table3-speed": PaperSource("Table 3, Sec. 4.4.3", "achieves very close efficiency compared with MIPF and IDMOT"),
    "table3-speed-cmct": PaperSource("Table 3, Sec. 4.4.3", "the proposed BMCT outperforms the CMCT in speed"),
    "fig7-hijacked": PaperSource(
        "Fig. 7a, Sec. 4.1", "Many trackers are hijacked by targets with strong local observation"
    ),
    "fig7-idmot": PaperSource("Fig. 7b, Sec. 4.1", "IDMOT has improved the performance"),
    "fig7-idmot-fails": PaperSource("Fig. 7b, Sec. 4.1", "this approach has two failure cases"),
    "fig7-bmct": PaperSource("Fig. 7c, Sec. 4.1", "BMCT rectifies these problems"),
    "fig7-all": PaperSource("Fig. 7c, Sec. 4.1", "tracks all of the targets robustly"),
    "fig7-direction": PaperSource("Fig. 7b, Sec. 4.1", DIRECTION),
    "fig7-direction-clutter": PaperSource("Fig. 7b, Sec. 4.1", "a strong clutter nearby attracts one tracker away"),
    "fig7-direction-bmct": PaperSource("Fig. 7c, Sec. 4.1", "BMCT rectifies these problems"),
    "fig7-line": PaperSource("Fig. 7b, Sec. 4.1", "their labels are falsely exchanged due to their similar inertia"),
    "fig7-line-bmct": PaperSource("Fig. 7c, Sec. 4.1", "BMCT rectifies these problems"),
    "fig7-row": OWN,
    "cmct": PaperSource("Sec. 4.2", WRONG_TARGETS),
    "cmct-own-bmct": OWN,
    "cmct-wide-bmct": OWN,
    "hall": PaperSource("Fig. 8, Sec. 4.2", "BMCT produced very robust results in each camera view"),
    "hall-fr_p-background": PaperSource("Sec. 4.2", CLUTTER),
    "hall-fr_l-background": PaperSource("Sec. 4.2", CLUTTER),
    "hall-fr_p-pca": OWN,
    "hall-fr_l-pca": OWN,
    "living-room": PaperSource("Fig. 10, Sec. 4.2", "achieves a very robust performance"),
    "living-room-fr_p-idmot": OWN,
    "living-room-fr_l-idmot": OWN,
    "campus": PaperSource("Fig. 11, Sec. 4.3", "The proposed BMCT achieves stable tracking results on these videos"),
    "campus-fr_p-idmot": OWN,
    "campus-fr_l-idmot": OWN,
    "unseen-idmot": PaperSource("Sec. 4.2", "only IDMOT instead of BMCT is implemented"),
    "unseen-fails": PaperSource("Sec. 4.2", "The only failure case of BMCT occurs in camera 2"),
    "unseen-cameras": PaperSource("Sec. 4.2", "By using more cameras, such failure cases could be avoided"),
    "balls": OWN,
    "balls-cost": PaperSource("Sec. 4.4.1", "increases linearly with the number of targets and cameras"),
    "radius": OWN,
    "views": OWN,
    "views-cost": PaperSource("Sec. 4.4.1", "increases linearly with the number of targets and cameras"),
    "motion": OWN,
    "motion-fr_p": PaperSource("Sec. 5", DIFFERENT),
    "motion-fr_l": PaperSource("Sec. 5", DIFFERENT),
    "loop": OWN,
}
