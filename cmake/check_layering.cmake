# Fails, naming file:line, when a file in src/ or tools/ includes a folder it must not see.
#   cmake -DROOT=path/to/repository -P check_layering.cmake

cmake_minimum_required(VERSION 3.25)

set(allowed_base base)
set(allowed_autodiff base autodiff)
set(allowed_nn base autodiff nn)
set(allowed_fem base autodiff fem)
set(allowed_nmp base autodiff nn fem nmp)
set(allowed_capi base autodiff nn fem nmp capi)
set(allowed_tools base autodiff nn fem nmp tools)
set(folders base autodiff nn fem nmp capi tools)

if(NOT IS_DIRECTORY "${ROOT}/src")
  message(FATAL_ERROR "usage: cmake -DROOT=REPOSITORY -P check_layering.cmake (no folder '${ROOT}/src')")
endif()

file(GLOB_RECURSE files RELATIVE "${ROOT}"
  "${ROOT}/src/*.h" "${ROOT}/src/*.cpp" "${ROOT}/tools/*.h" "${ROOT}/tools/*.cpp")
list(SORT files)

set(complaints 0)
foreach(file IN LISTS files)
  string(REGEX REPLACE "^(src/)?([^/]+)/.*" "\\2" folder "${file}")
  if(NOT folder IN_LIST folders)
    message(SEND_ERROR "${file}:1: '${folder}' is not a known folder")
    math(EXPR complaints "${complaints} + 1")
    continue()
  endif()

  # One list element per line: take out what CMake lists give a meaning to.
  file(READ "${ROOT}/${file}" text)
  string(REGEX REPLACE "[];[]" " " text "${text}")
  string(REPLACE "\\" " " text "${text}")
  string(REPLACE "\n" ";" lines "${text}")
  set(number 0)
  foreach(line IN LISTS lines)
    math(EXPR number "${number} + 1")
    if(line MATCHES "^[ \t]*#[ \t]*include[ \t]*[\"<]([^/\">]+)/")
      set(seen "${CMAKE_MATCH_1}")
      if(seen STREQUAL ".." OR seen STREQUAL ".")
        message(SEND_ERROR "${file}:${number}: name the folder from src/, not a relative path")
        math(EXPR complaints "${complaints} + 1")
      elseif(seen IN_LIST folders AND NOT seen IN_LIST allowed_${folder})
        message(SEND_ERROR "${file}:${number}: ${folder} must not include ${seen}")
        math(EXPR complaints "${complaints} + 1")
      endif()
    endif()
  endforeach()
endforeach()

list(LENGTH files n_files)
if(n_files EQUAL 0)
  message(SEND_ERROR "no source file under ${ROOT}")
endif()
message(STATUS "layering: ${n_files} files, ${complaints} forbidden includes")
