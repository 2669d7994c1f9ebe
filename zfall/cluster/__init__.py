"""Jobs of a hydra sweep on a Ray cluster: ``hydra/launcher=ray``, see ``ray.yaml``.

``launcher`` is what hydra calls, ``connection`` finds or starts the cluster, ``job`` is what runs
on a node, ``mirror`` carries files between disks.
"""
