"""Calibration of a rig from a ChArUco board that is walked through the scene.

    board/                    the board, its print at true size, and its corners in pictures
    walk.py, track.py         pictures of a walk; the corners that one camera saw, as curves in time
    first_lens.py, sync.py    first lenses by camera, first time offsets by pair of cameras
    walk_coverage.py          what each camera has seen of the board so far, while somebody walks
    known_lens.py             lenses known before, against what the walk shows
    instants.py, graph.py     the instants used, and first poses, chained through shared views
    adjustment/               bundle adjustment: lenses, poses, offsets and boards together
    apart.py, stillness.py    why cameras cannot be joined; one that was turned in the midst of the walk
    trust.py                  what was seen too little, and cameras that disagree
    world.py                  metres with the floor at z = 0 and z up
    solve.py                  all of that in order
    report.py, files.py       the report with its picture; files that `train` and `serve` read
    features/, checks/        calibration without a board; checks before filming

Inside this package pixel centres lie at integers, as OpenCV has it; `Camera` has them at half-integers.
"""
