"""Methods `ekf`, `ukf` and `iekf`: a Gaussian instead of particles, the baselines of [Ercan] Sec. 4."""
