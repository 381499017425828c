"""The tables, declared: what stages pass on, by what they are about.  `occlog.records.tables` names them all."""
