"""The statements of [Lee] that are judged: where the thesis makes them, and its words."""

from __future__ import annotations

from occlog.papers.verdicts import OWN, PaperSource, Sources

OUTPERFORMS = "the proposed method outperforms the direct 3-D method"
BETTER = "Selected planes based on PPS shows better performance"
CLOSER = "more accurate as the visual sensor's sampling time T_v is close to the acoustic sampling time T_s"
LESS = "requires less visual sensor resources than the periodic visual sensor cooperation for the same performance"


def _scenario(number: int, figure: str, page: int, words: str) -> Sources:
    return {
        f"scenario{number}": PaperSource(f"{figure}, Sec. 2.4.{number}", words, page),
        f"scenario{number}-phi": PaperSource(f"Sec. 2.4.{number}", "", 39 + (number > 2)),
        f"scenario{number}-theta": PaperSource(f"Sec. 2.4.{number}", "", 39 + (number > 2)),
        f"scenario{number}-printed-better": OWN,
        f"scenario{number}-direct-bound": PaperSource(f"{figure}, Sec. 2.4.{number}", "", page),
        f"scenario{number}-pps-bound": PaperSource(f"{figure}, Sec. 2.4.{number}", "", page),
    }


NOISIER = PaperSource(
    "Fig. 3-4, Sec. 3.3.1", "As the noise variance increases, the estimation has a higher Root-Mean-Square", 58
)
SOURCES: Sources = {
    "eq2.13": PaperSource("Eq. 2.13, Sec. 2.1.4", "", 18),
    "eq2.14": PaperSource("Eqs. 2.14 and 3.13, Secs. 2.1.4 and 3.3.1", "the clockwise coordinated turn (CT) model", 18),
    "eq2.15": PaperSource("Eq. 2.15, Sec. 2.1.4", "Constant Acceleration (CA) model", 18),
    "eq2.24": PaperSource("Eqs. 2.22 to 2.24, Sec. 2.2.3", "The data conversion", 27),
    "eq2.30": PaperSource("Eqs. 2.30 and 2.39, Sec. 2.3.2", "we can assume that J_0 is the zero matrix", 37),
    "eq2.32": PaperSource("Eqs. 2.30, 2.32, 2.33 and 2.39, Secs. 2.3.1 and 2.3.2", "", 34),
    "eq2.36": PaperSource("Eqs. 2.36 to 2.38, Sec. 2.3.1", "", 34),
    "eq3.10": PaperSource("Eqs. 3.7 to 3.11, Sec. 3.2.1", "", 48),
    "eq3.12": PaperSource("Eq. 3.12, Sec. 3.3.1", "", 56),
    "eq4.4": PaperSource("Eqs. 4.3 and 4.4, Sec. 4.3.1", "", 86),
    "eq4.11": PaperSource("Eq. 4.11, Sec. 4.3.1", "", 86),
    "fig2.9-lowest": PaperSource(
        "Fig. 2-9, Sec. 2.4.4", "the projected measurement with the lowest variance is [...] yz-plane from sensor 1", 41
    ),
    "fig2.9-second": PaperSource(
        "Fig. 2-9, Sec. 2.4.4", "the second lowest variance is with yz-plane from sensor 2", 41
    ),
    "fig2.9-later": PaperSource(
        "Fig. 2-9, Sec. 2.4.4", "zx-plane from sensor 1 and yz-plane from sensor 2 are selected", 41
    ),
    "sec2.2.2": PaperSource("Tables 2.1 and 2.2, Sec. 2.2.2", "", 24),
    # Chapter 2
    "variances-first": PaperSource("Figs. 2-2 and 2-3", "", 13),
    "variances-yz": PaperSource("Eqs. 2.1 and 2.2", "", 12),
    "variances-zx": PaperSource("Eqs. 2.1 and 2.2", "", 12),
    "variances-rule": PaperSource(
        "Sec. 2.2.1", "when phi is measured between 45 and 135 degrees, yz-plane is chosen", 20
    ),
    "variances-band": PaperSource(
        "Fig. 2-2, Sec. 2.1.2", "angles phi between 45 and 135 degrees are projected with a smaller variance", 13
    ),
    "variances-xy": PaperSource("Sec. 2.2.1", "the projected variance in xy-plane is the second best plane", 20),
    "fig2.7-larger": PaperSource(
        "Fig. 2-7, Sec. 2.2.2", "weight-sums of PPS method is larger than those of the direct 3-D Method", 29
    ),
    "fig2.7-unit": OWN,
    "fig2.7-sensitive": PaperSource(
        "Fig. 2-7, Sec. 2.2.2",
        "the selected plane is less sensitive to measurement noise than the direct 3-D model",
        29,
    ),
    "table2.1": PaperSource("Table 2.1", "", 26),
    "table2.1-alike": PaperSource("Table 2.1, Sec. 2.2.2", "have similar tracking performances", 26),
    "table2.2": PaperSource("Table 2.2", "", 26),
    "table2.2-weighted": PaperSource(
        "Table 2.2, Sec. 2.2.2", "the planes weighted combining method maintains the object tracking", 26
    ),
    "table2.2-inverse": OWN,
    **_scenario(1, "Fig. 2-10", 41, BETTER),
    **_scenario(2, "Fig. 2-11", 41, BETTER),
    **_scenario(3, "Fig. 2-12", 42, OUTPERFORMS),
    "scenario3-switch": PaperSource(
        "Fig. 2-12", "phi of the first 13 time instants is between 48.24 and 45.42 degrees", 42
    ),
    **_scenario(4, "Fig. 2-13", 43, OUTPERFORMS),
    "particles": PaperSource("Sec. 2.5", OUTPERFORMS, 43),
    "particles-bound": OWN,
    "sensors": PaperSource("Figs. 2-12 and 2-13, Sec. 2.4.5", "better comparing single sensor based estimation", 43),
    # Chapter 3
    "sec3.2.2": OWN,
    "sec3.2.2-improves": PaperSource(
        "Secs. 3.2.2 and 5.2.3", "the refined estimation with visual sensors improves any coarse estimation", 138
    ),
    "sec3.2.2-depth": PaperSource("Eqs. 5.39 and 5.40, Sec. 5.2.3", "the Equation (5.39) is modified", 135),
    "fig3.4": PaperSource("Fig. 3-4, Sec. 3.3.1", "", 58),
    "fig3.4-grows": NOISIER,
    "fig3.4-ends": NOISIER,
    "fig3.6": PaperSource("Fig. 3-6, Sec. 3.3.1", CLOSER, 60),
    "fig3.7-count": PaperSource(
        "Fig. 3-7, Eq. 3.14", "The visual sensor cooperation should be triggered in case of (3.14)", 63
    ),
    "fig3.13-bearing": PaperSource(
        "Figs. 3-8, 3-10 and 3-13, Eq. 3.15", "cooperation are triggered not by (3.16) but from (3.15)", 69
    ),
    "fig3.11-ellipse": PaperSource("Fig. 3-11, Eq. 3.16", "the triggering condition in (3.15) is not enough", 67),
    "fig3.8": PaperSource(
        "Fig. 3-8, Sec. 3.3.3",
        "The triggering based on (3.14) cannot trigger [...] for a simultaneous varying number of objects",
        63,
    ),
    "fig3.8-soon": PaperSource(
        "Fig. 3-8, Sec. 3.3.3",
        "should trigger the visual sensor association by considering the estimation performance",
        64,
    ),
    "fig3.8-more": OWN,
    "fig3.10-drawn": PaperSource(
        "Fig. 3-10, Eq. 3.15", "strays off from the 95 % confidence true bearing range of z^1(k)", 66
    ),
    "fig3.11-drawn": PaperSource("Fig. 3-11, Eq. 3.16", "the triggering condition in (3.15) is not enough", 67),
    "fig3.13-drawn": PaperSource("Fig. 3-13", "triggered not by (3.16) but from (3.15)", 69),
    "fig3.14": PaperSource("Fig. 3-14, Sec. 3.3.4", LESS, 71),
    "fig3.14-none": PaperSource("Table 3.1", "", 72),
    "fig3.14-thesis-count": OWN,
    "fig3.14-thesis-spread": OWN,
    "fig3.14-joint": OWN,
    "table3.1": PaperSource("Table 3.1", "", 72),
    "table3.1-period": PaperSource(
        "Table 3.1, Sec. 3.3.4", "visual sensor's sampling time T_v is approximately 4.55 T_s", 70
    ),
    "fig3.18": PaperSource("Fig. 3-18, Sec. 3.4.3", "", 77),
    "fig3.19": PaperSource("Fig. 3-19, Sec. 3.4.3", "", 78),
    "fig3.19-silence": PaperSource(
        "Fig. 3-19, Sec. 3.4.3", "the number of objects and the number of measurements are different", 78
    ),
    "fig3.20": PaperSource("Fig. 3-20, Sec. 3.4.3", "", 79),
    "fig3.21": PaperSource("Fig. 3-21, Sec. 3.4.3", "", 80),
    # Chapter 4
    "fig4.3": PaperSource("Fig. 4-3, Sec. 4.4.1", "P(G_1) is more than 0.99 until sigma_xy^2 reaches 1.135", 95),
    "fig4.3-n4": PaperSource("Fig. 4-3, Sec. 4.4.1", "more than 0.99 until 0.480, and more than 0.5 when 1.565", 95),
    "fig4.3-n3": PaperSource("Fig. 4-3, Sec. 4.4.1", "more than 0.99 until 0.195, and more than 0.50 when 0.635", 95),
    "fig4.3-n2": PaperSource("Fig. 4-3, Sec. 4.4.1", "more than 0.99 until 0.085, and more than 0.50 when 0.325", 95),
    "fig4.3-n1": PaperSource("Fig. 4-3, Sec. 4.4.1", "more than 0.99 until 0.030, and more than 0.55 when 0.235", 95),
    "fig4.3-crossing": PaperSource(
        "Fig. 4-3, Sec. 4.4.1", "P(G_1) with N(S_E1) = 1 becomes larger than P(G_1) with N(S_E1) = 2 [and 3]", 95
    ),
    "case1": PaperSource("Fig. 4-4, Sec. 4.4.2", "", 96),
    "case2": PaperSource("Fig. 4-5, Sec. 4.4.2", "", 97),
    "case3": PaperSource("Fig. 4-6, Sec. 4.4.2", "", 98),
    "detection": PaperSource("Sec. 4.1", "", 81),
    "false": PaperSource("Sec. 4.1", "preventing from the propagation of the false object detection", 81),
    "fused": OWN,
    "twice": OWN,
    # Chapter 5
    "layout": PaperSource("Figs. 5-10 to 5-14, Sec. 5.2.1", page=109),
    "order": PaperSource("Figs. 5-10 to 5-14, Sec. 5.2.1", page=109),
    "width": PaperSource("Sec. 5.2.1", page=102),
    "ends": PaperSource("Sec. 5.2.1", page=102),
    "bias": OWN,
    "corrected": OWN,
    "race": PaperSource("Sec. 5.2.1", page=102),
    "separable": PaperSource("Fig. 5-20, Sec. 5.2.1", "Among races: different skin and hair color", 116),
    "angles": PaperSource("Sec. 5.2.1", page=102),
    "pooled": OWN,
    "suspend": PaperSource("Sec. 5.2.1", page=102),
    "motion": PaperSource("Figs. 5-8 and 5-9, Sec. 5.2.1", page=108),
    "fig5.26": PaperSource("Fig. 5-26, Sec. 5.2.2", page=121),
    "fig5.27": PaperSource("Fig. 5-27, Sec. 5.2.2", page=123),
    "fig5.29": PaperSource("Fig. 5-29, Sec. 5.2.2", page=125),
    "fig5.30": PaperSource("Fig. 5-30, Eqs. 5.29 to 5.32", page=126),
    "near": PaperSource("Eq. 5.25, Sec. 5.2.2"),
    "virtual": PaperSource("Fig. 5-32, Sec. 5.2.3", page=133),
    "readers": PaperSource("Sec. 5.2.3", "The more readers are placed, the more accurate the estimation is"),
    "refine": PaperSource(
        "Fig. 5-37, Sec. 5.2.3", "the refined estimation with visual sensors improves any coarse", 138
    ),
    "refine-5.39": PaperSource("Eq. 5.39, Sec. 5.2.3"),
    "refine-5.40": PaperSource("Eq. 5.40, Sec. 5.2.3"),
    "refine-depth": PaperSource("Eqs. 5.39 and 5.40, Sec. 5.2.3"),
    "refine-tail": PaperSource("Eqs. 5.39 and 5.40, Sec. 5.2.3"),
    "refine-rays": OWN,
    "hops": PaperSource("Figs. 5-45b and 5-46b, Sec. 5.2.3", "", 144),
    "hops-2-visual": PaperSource(
        "Figs. 5-45b and 5-46b, Sec. 5.2.3", "delay of visual sensing in RBVC is larger than that of SBVC", 144
    ),
    "hops-3-visual": PaperSource(
        "Figs. 5-45b and 5-46b, Sec. 5.2.3", "delay of visual sensing in RBVC is larger than that of SBVC", 144
    ),
    "traffic": PaperSource("Sec. 5.2.3, traffic of RBVC and SBVC", page=144),
}
