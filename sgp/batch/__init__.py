"""Many sources: plan, state on disk, workers here or on a cluster, tables of results."""
