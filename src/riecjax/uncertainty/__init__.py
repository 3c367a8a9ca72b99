"""How uncertain estimates are: blocks of time, then covariances of them, then intervals.

- `covariances`: how long a block must be so that its errors may count as independent; scores and
  influence of each; jackknife, HAC sandwich, Bell and McCaffrey's of few blocks, least squares'
  own; studentized replicates; inflation where records disagree.
- `intervals`: what users choose among, and how all of this comes together.
"""
