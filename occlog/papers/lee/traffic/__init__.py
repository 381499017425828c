"""[Lee] Sec. 5.2.3: data traffic of visual compensation in the routers (RBVC) or in the server (SBVC)."""
