"""Who gives references and takes poses: SUMO."""
