"""[Lee] Sec. 5.2.3: virtual sensors of readers, and visual refinement."""
