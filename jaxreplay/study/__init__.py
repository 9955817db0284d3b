"""Parameter studies: a config becomes runs, runs are done in shards, shards make one dataset.

Read the modules in the order in which data passes through them: `config` (with `parse` and
`factors`), `demonstrations`, `runs`, `shard`, `store`, `run` (with `workers` and `progress`),
`open`, `dataset`.
Beside them, `cost` estimates what a study will take, and `again` repeats one of its runs.
"""
