"""The statements of [Ercan] that are judged: where the paper makes them, and its words."""

from __future__ import annotations

from occlog.papers.verdicts import OWN, PaperSource, Sources

CLOSE_TO_BRUTE = "close to that of the brute-force method"
BETTER = "better than the other heuristics"
NOT_SUBSTANTIAL = "the difference is not substantial considering the variations around the average RMSEs"
IMPROVE = (
    "the average RMSEs improve as the number of cameras used or as the available occluder prior accuracy increases"
)

SOURCES: Sources = {
    "eq2": PaperSource("Eq. 2, Sec. 3.1"),
    "appendix-b": PaperSource("App. B"),
    "sec4.2-dependent": PaperSource("Sec. 4.2", "it is more likely that the other one also cannot see it"),
    "eq9": PaperSource("Eqs. 8 and 9, Sec. 4.2", "we can approximate this term using recursion"),
    "sec4.2-product": PaperSource(
        "Eqs. 8 and 9, Sec. 4.2", "cannot simply be expressed as a product, as the occlusions are not independent"
    ),
    "sec6.1-vertices": PaperSource("Fig. 5, Sec. 6.1", "because their fields of view have better coverage of the room"),
    "sec6.1-orthogonal": PaperSource(
        "Fig. 5, Sec. 6.1", "cameras that are placed orthogonally are used for better triangulation"
    ),
    "baselines-ekf": PaperSource("Sec. 4", "using an extended kalman filter (EKF) ... is not very successful"),
    "baselines-ukf": PaperSource("Sec. 4", "the use of an unscented Kalman filter (UKF) is more promising"),
    "baselines-ukf-constraints": PaperSource(
        "Sec. 4",
        "its performance degrades quickly when the static occluders and limited field of view constraints are "
        "considered",
    ),
    "baselines-ukf-particles": PaperSource("Sec. 4", "Given these considerations, we decided to use a particle filter"),
    "baselines-map": PaperSource(
        "Sec. 4", "failed at the optimization stage of the MAP estimator, as the feasible set is highly disconnected"
    ),
    "baselines-map-particles": PaperSource("Sec. 4", "Given these considerations, we decided to use a particle filter"),
    "baselines-sharp": OWN,
    "baselines-false": OWN,
    "baselines-priors": OWN,
    "selection-period": PaperSource(
        "Sec. 5",
        "a smaller T would result in a more up-to-date set of cameras [...], hence a better tracking performance",
    ),
    "joint": PaperSource("Sec. 4.4", "becomes computationally prohibitive for a large number of objects"),
    "joint-error": OWN,
    "fig6": PaperSource("Fig. 6, Sec. 6.1"),
    "fig6-rmse-max": PaperSource("Fig. 6, Sec. 6.1", "the worst case average RMSE when there are no measurements"),
    "fig6-rmse-occ": PaperSource("Fig. 6, Sec. 6.1", "RMSE_occ = 6.67 (obtained by setting sigma_psi = 8)"),
    "fig6-variation": PaperSource(
        "Figs. 6 to 9, Sec. 6.1", "the variations of RMSE_tr also increase as RMSE_occ increases"
    ),
    "fig7": PaperSource("Fig. 7, Sec. 6.1"),
    "fig7-none-to-known": PaperSource("Fig. 7, Sec. 6.1", "around a factor of 2.34 times increase in average RMSE_tr"),
    "fig7-none-to-crossing": PaperSource("Fig. 7, Sec. 6.1", "the improvement reduces to around 1.94 times"),
    "fig7-crossing": PaperSource("Fig. 7, Sec. 6.1", "average RMSE_tr = RMSE_occ at around 3.72"),
    "fig7-deviation": PaperSource(
        "Fig. 7, Sec. 6.1", "the variation also improves by about 3.4 times for these points"
    ),
    "fig7-variation": PaperSource(
        "Figs. 6 to 9, Sec. 6.1", "the variations of RMSE_tr also increase as RMSE_occ increases"
    ),
    "fig7-rmse-max": PaperSource("Fig. 7, Sec. 6.1", "RMSE_max reduces to 21.4 units for this case"),
    "fig8-trade-off": PaperSource(
        "Fig. 8, Sec. 6.1", "there is a trade-off between the number of cameras and the accuracy of the occluder priors"
    ),
    "fig8-no-priors": PaperSource("Fig. 8, Sec. 6.1"),
    "fig9-few": PaperSource("Fig. 9, Sec. 6.1", "very few moving occluders, prior information does not help"),
    "fig9-more": PaperSource(
        "Fig. 9, Sec. 6.1", "As the number of occluder increases, prior information becomes more useful"
    ),
    "fig9-many": PaperSource("Fig. 9, Sec. 6.1", "the difference decreases when too many occluders are present"),
    "fig9-variation": PaperSource(
        "Figs. 6 to 9, Sec. 6.1", "the variations of RMSE_tr also increase as RMSE_occ increases"
    ),
    "fig10-linear": PaperSource("Fig. 10, Sec. 6.1", "close to linear in N"),
    "fig10-exponential": PaperSource(
        "Fig. 10, Sec. 6.1", "the rate of increase of the CPU time using priors is significantly lower than 2^N"
    ),
    "fig10-as-none": PaperSource("Fig. 10, Sec. 6.1", "close to the rate of increase of the RMSE_occ = RMSE_max case"),
    "fig12": PaperSource("Fig. 12, Sec. 6.2", "outperforms the other selection heuristics"),
    "fig12-brute": PaperSource("Fig. 12, Sec. 6.2", "performs close to the brute-force method"),
    "fig12-fixed-worst": PaperSource("Fig. 12, Sec. 6.2", "The fixed selection heuristic performs worst"),
    "fig12-weak": PaperSource("Fig. 12, Sec. 6.2", "within one standard deviation of that of the perspective model"),
    "fig12-six": PaperSource(
        "Fig. 12, Sec. 6.2", "by only using six cameras the performance of using all 12 can be achieved"
    ),
    "fig12-rmse-occ": PaperSource("Fig. 12", "RMSE_occ is 11.5 units"),
    "fig12-rmse-max": PaperSource("Fig. 12", "RMSE_max is 47.9 units"),
    "fig14": PaperSource("Fig. 14, Sec. 7", IMPROVE),
    "fig14-small": PaperSource("Fig. 14, Sec. 7", NOT_SUBSTANTIAL),
    "fig14-rmse-occ": PaperSource("Fig. 14, Sec. 7", "RMSE_occ = 12.1 inches"),
    "fig14-rmse-max": PaperSource("Fig. 14, Sec. 7", "RMSE_max = 77.5 inches"),
    "fig14-recorded": PaperSource("Fig. 14, Sec. 7", IMPROVE),
    "fig15": PaperSource("Fig. 15, Sec. 7", BETTER),
    "fig15-brute-force": PaperSource("Fig. 15, Sec. 7", CLOSE_TO_BRUTE),
    "fig15-variation": PaperSource("Fig. 15, Sec. 7", "the variations of the RMSEs values are also large"),
    "fig15-rmse-occ": PaperSource("Fig. 15, Sec. 7", "RMSE_occ is 12.1 inches"),
    "fig15-recorded": PaperSource("Fig. 15, Sec. 7", BETTER),
    "fig15-recorded-brute-force": PaperSource("Fig. 15, Sec. 7", CLOSE_TO_BRUTE),
    "fig15-recorded-variation": PaperSource("Fig. 15, Sec. 7", "the variations of the RMSEs values are also large"),
    "fig17-printed": PaperSource(
        "Fig. 17, App. B", "most of the 16,000 points still lie in the 3 sigma tolerance range"
    ),
    "fig17": OWN,
}
