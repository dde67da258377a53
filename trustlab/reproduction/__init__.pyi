from .audit.audit import audit as audit
from .calibration import (
    Calibration as Calibration,
    calibrate as calibrate,
    read_calibration as read_calibration,
    write_calibration as write_calibration,
)
from .effects import (
    model_effects as model_effects,
    printed_effects as printed_effects,
    simulated_effects as simulated_effects,
)
from .printed import compare as compare
from .published import (
    PublishedStudy as PublishedStudy,
    PublishedStudyError as PublishedStudyError,
    published_models as published_models,
    published_studies as published_studies,
    published_table as published_table,
    verdicts as verdicts,
)
from .reconstruction.feasibility import (
    Feasibility as Feasibility,
    ReconstructionError as ReconstructionError,
    feasibility as feasibility,
    reconstruct as reconstruct,
)
