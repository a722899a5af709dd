#pragma once

#include "base/check.h"
#include "fem/tet_mesh.h"
