#include "fem/vtk_xml.h"

#include <expat.h>

#include <algorithm>
#include <memory>
#include <new>

#include "base/check.h"

namespace nmp::fem {

namespace {

constexpr std::size_t kMaxDepth = 64;
constexpr std::size_t kPiece = std::size_t{1} << 24;  // given to expat at a time

}  // namespace

void VtkXml::fail(const std::string& expected, const std::string& found) const {
  throw InputError(text(name_, ":", line(), ": expected ", expected, ", found ", found));
}

// Handlers are called from C, which no exception may cross.
template <class Handler>
void VtkXml::guard(Handler&& handler) {
  if (failure_ || stopped_) return;
  note_progress();
  try {
    handler();
  } catch (...) {
    failure_ = std::current_exception();
    XML_StopParser(parser_, XML_FALSE);
  }
}

void VtkXml::note_progress() {
  seen_ = static_cast<std::size_t>(std::max<XML_Index>(0, XML_GetCurrentByteIndex(parser_)));
}

void VtkXml::parse() {
  const std::unique_ptr<XML_ParserStruct, void (*)(XML_Parser)> parser(
      XML_ParserCreate("UTF-8"), [](XML_Parser p) { XML_ParserFree(p); });
  if (!parser) throw std::bad_alloc();
  parser_ = parser.get();
  struct Forget {
    XML_ParserStruct*& parser;
    ~Forget() { parser = nullptr; }
  } const forget{parser_};
  XML_SetUserData(parser_, this);
  XML_SetElementHandler(
      parser_,
      [](void* self, const XML_Char* tag, const XML_Char** attributes) {
        VtkXml& xml = *static_cast<VtkXml*>(self);
        xml.guard([&] {
          if (xml.path_.size() >= kMaxDepth)
            xml.fail(text("tags at most ", kMaxDepth, " deep"), "more");
          xml.path_.emplace_back(std::string_view(tag).substr(0, 64));
          xml.begin(tag, attributes);
        });
      },
      [](void* self, const XML_Char*) {
        VtkXml& xml = *static_cast<VtkXml*>(self);
        xml.guard([&] {
          xml.end();
          xml.path_.pop_back();
        });
      });
  XML_SetStartDoctypeDeclHandler(
      parser_, [](void* self, const XML_Char*, const XML_Char*, const XML_Char*, int) {
        VtkXml& xml = *static_cast<VtkXml*>(self);
        xml.guard([&] { xml.fail(std::string(xml.kind_) + ", which has no DOCTYPE", "one"); });
      });
  XML_SetDefaultHandler(parser_, [](void* self, const XML_Char*, int) {
    static_cast<VtkXml*>(self)->note_progress();
  });
  for (std::size_t from = 0; !stopped_;) {
    const std::size_t n = std::min(kPiece, bytes_.size() - from);
    const bool is_last = from + n == bytes_.size();
    const XML_Status status =
        XML_Parse(parser_, bytes_.data() + from, static_cast<int>(n), is_last);
    if (failure_) std::rethrow_exception(failure_);
    if (stopped_) return;
    if (status != XML_STATUS_OK) {
      fail(std::string(kind_) + ", which is XML",
           text("'", printable(XML_ErrorString(XML_GetErrorCode(parser_))), "'"));
    }
    from += n;
    if (is_last) return;
    // A tag that goes on and on would be looked at again with every piece.
    if (from - seen_ > 2 * kPiece)
      fail(text("tags of less than ", kPiece, " bytes"), "a longer one");
  }
}

void VtkXml::stop() {
  stopped_ = true;
  XML_StopParser(parser_, XML_FALSE);
}

bool VtkXml::is_at(std::initializer_list<std::string_view> path) const {
  return std::equal(path_.begin(), path_.end(), path.begin(), path.end());
}

void VtkXml::check_root(std::string_view tag, Attributes attributes, std::string_view type) const {
  if (tag != "VTKFile") fail("the tag VTKFile", in_quotes(tag));
  const std::string found = find(attributes, "type");
  if (found != type) fail(text("the type ", type), in_quotes(found));
  const std::string version = find(attributes, "version");
  if (!version.empty() && version[0] != '0' && version[0] != '1' && version[0] != '2')
    fail("version 0.1 to 2", in_quotes(version));
}

std::string VtkXml::find(Attributes attributes, std::string_view name) {
  for (; *attributes; attributes += 2)
    if (name == attributes[0]) return attributes[1];
  return "";
}

std::size_t VtkXml::line() const { return parser_ ? XML_GetCurrentLineNumber(parser_) : 1; }

std::size_t VtkXml::tag_begin() const {
  return static_cast<std::size_t>(XML_GetCurrentByteIndex(parser_));
}

std::size_t VtkXml::tag_end() const {
  return tag_begin() + static_cast<std::size_t>(XML_GetCurrentByteCount(parser_));
}

}  // namespace nmp::fem
