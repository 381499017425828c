"""Figures of two recorded sequences as py-motmetrics prints them, by the names that it uses."""

from __future__ import annotations

PUBLISHED = {
    "TUD-Campus": {
        "IDF1": "55.8%", "IDP": "73.0%", "IDR": "45.1%", "Rcll": "58.2%", "Prcn": "94.1%", "GT": "8", "MT": "1",
        "PT": "6", "ML": "1", "FP": "13", "FN": "150", "IDs": "7", "FM": "7", "MOTA": "52.6%", "MOTP": "0.277",
        "DETA": "41.8%", "ASSA": "36.9%", "HOTA": "39.1%",
    },
    "TUD-Stadtmitte": {
        "IDF1": "64.5%", "IDP": "82.0%", "IDR": "53.1%", "Rcll": "60.9%", "Prcn": "94.0%", "GT": "10", "MT": "5",
        "PT": "4", "ML": "1", "FP": "45", "FN": "452", "IDs": "7", "FM": "6", "MOTA": "56.4%", "MOTP": "0.346",
        "DETA": "39.2%", "ASSA": "40.9%", "HOTA": "39.8%",
    },
}  # fmt: skip
