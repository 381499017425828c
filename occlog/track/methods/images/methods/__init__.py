"""The methods `mipf`, `idmot`, `cmct`, `bmct` and `mcmc`, step by step."""
