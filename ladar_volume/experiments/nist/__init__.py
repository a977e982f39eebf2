"""The box experiment of NIST's TINvolume (seed 000): scene, experiments, tables, figures."""
