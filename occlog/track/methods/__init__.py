"""The tracking methods: one folder each, with settings, filter and kernels."""
