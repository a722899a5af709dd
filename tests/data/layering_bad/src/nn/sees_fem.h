#pragma once

#include "autodiff/tape.h"
#include "fem/tet_mesh.h"
