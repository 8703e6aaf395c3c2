"""The command ``rfpsurvey survey``, and the survey in a folder that it wrote."""

from pathlib import Path

from rfpsurvey import inputs
from rfpsurvey._cli import _app, _surveys
from rfpsurvey._cli._command import command
from rfpsurvey._cli._print import print_text
from rfpsurvey.inputs import Given, keys_of
from rfpsurvey.survey import SurveyKeys, call_of


@command(
    SurveyKeys,
    "tiles.path instrument.name options.allocator options.constraints catalog.visits tiles.passes epoch "
    "catalog.columns output.folder output.resume output.replan workers rng output.plot output.report output.overwrite",
    argument="catalog.path",
)
def survey(keys: SurveyKeys, given: Given) -> None:
    r"""Plan the tiles of a survey so that as many targets as possible are observed the requested number of times.

    Examples
    --------
    rfpsurvey survey
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \
        --folder plan --report plan.html
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 \
        --folder plan --resume
    rfpsurvey survey stars.fits --allocator repair \
        --constraint "required 4711" --constraint "keep_out 95.0 23.1 0.01"
    rfpsurvey survey stars.fits --allocator joint --set joint.time_limit=600 \
        --folder plan
    rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --folder plan \
        --write-plan plan.toml
    rfpsurvey survey plan.toml --workers 2
    rfpsurvey survey stars.fits --tiles tiles.ecsv --folder plan \
        --set rule.after_success=4 --set rule.retries=2
    rfpsurvey survey plan --replan --report rest.html
    rfpsurvey survey hats_catalog --tiles tiles.ecsv \
        --set scheduler=tcp://10.0.0.1:8786 --folder plan
    """
    _surveys.check_replan(keys)
    paths = keys.catalog.path, keys.tiles.path, keys.instrument.name, keys.instrument.broken, keys.cadences
    _app.check_outputs(keys.output, (*paths, keys.conditions.get("path")))
    call = call_of(keys, tell=print_text)
    with _app.seed_of(keys.catalog.path), _surveys.workers(keys) as executor:
        options = {"folder": keys.output.folder, "resume": keys.output.resume or keys.output.replan}
        _surveys.run(executor, call | options, keys.output, given)


def values_of(path: Path | None) -> dict | None:
    """Return the values of the keys in the plan file of a survey, or None if the path is not the folder of a survey."""
    folder = None if path is None else inputs.survey_folder(path)
    if folder is None:
        return None
    values: dict = {}
    inputs.add_file(keys_of(SurveyKeys), values, folder / inputs.RECORD)
    return values
