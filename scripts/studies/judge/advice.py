"""Printed lines without a statement that could be false, or whose content is judged elsewhere; each with the reason."""

from __future__ import annotations

_ADVICE = "says what to do"
_RIG = "repeats what the rig file has or lacks"
_FILES = "names files"
_BY_JSON = "judged by diagnosis.json, where the same stands"
OF_CALIBRATE = {
    r"^Fitted besides, |^The rig file (takes the gains|describes no iron)": _RIG,
    r"^(suspect|unusable): ": "a doubt; its numbers are judged, and what holds only if nothing is wrong",
    r"^Run coilcal diagnose|^Do not use it|^Raise `degree`": _ADVICE,
    r"^Something in the rig file|^With the causes": "a doubt",
    r"^parameter +median": "head of a table",
    r"^report: |^written: ": _FILES,
    r"^not determined by the data|^\S+: readings determine \d+ of|^No sensor turns": "a limit of the readings, without a truth",
}
OF_DIAGNOSE = {
    r"^verdict: |^Even \d+ things wrong at once": "judged by the causes of the verdict",
    r"^written: ": _FILES,
    r"^Readings .*are not as they were measured": _BY_JSON,
    r"components? (is|are) probably (an )?outlier": _BY_JSON,
    r"^Size, with 90 %|known best:|\(.+ to .+\)$|^[\w −]+ {2,}[−\d]\S*( \S+)?$": _BY_JSON,
    r"\([a-z]\w*(\[[\w, ]+\])?(, [<>\d ]+ %)?\)": _BY_JSON,
    r"^this session cannot tell apart|The readings leave room": "a limit of the readings, without a truth",
    r"^The prior of .* holds back": "a limit of the readings, without a truth",
    r"^To tell them apart, measure|^Check .* in the rig file|^Use rig_extended|^Measure again|^Put the record": _ADVICE,
    r"^Look first at what depends on": _ADVICE,
    r"rig_extended.yaml also has": "repeats what a file has",
    r"^Predictions are corrected|^Nothing is corrected|^What is left looks like|^Intervals are widened": "says what the program did",
    r"^The model of the source itself|that how far readings miss depends on": "a description of residuals, without a truth",
    r"^The diagnosis ended early": "says what the program did",
}
