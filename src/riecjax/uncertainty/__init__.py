"""How uncertain estimates are: block statistics, then covariances of them, then intervals.

- `block_length`: how long a block of time must be so that its errors may count as independent.
- `block_statistics`: normal equations, scores and influence of each block.
- `covariances`: jackknife, HAC sandwich and least squares' own; inflation where records disagree.
- `small_samples`: Bell and McCaffrey's sandwich for few blocks.
- `bootstrap`: studentized replicates of whole procedures.
- `intervals`: what users choose among, and how all of this comes together.
"""
