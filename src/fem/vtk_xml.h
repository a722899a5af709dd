#pragma once

#include <cstddef>
#include <exception>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

struct XML_ParserStruct;

namespace nmp::fem {

/// What the readers of VTK's XML files share. Expat reads the XML: it keeps no tree and does not
/// recurse, and it can be stopped before appended data, which may hold any bytes and so are no XML.
/// Tags are at most 64 deep and below 16 MiB, a DOCTYPE is refused.
class VtkXml {
 public:
  VtkXml(const VtkXml&) = delete;
  VtkXml& operator=(const VtkXml&) = delete;

  /// @throws InputError  at the tag that is being read
  [[noreturn]] void fail(const std::string& expected, const std::string& found) const;

 protected:
  using Attributes = const char**;  // name, value, name, value, ..., null

  /// @param bytes, name  of the file; both must outlive the object
  /// @param kind  of file, in messages: "a VTU file"
  VtkXml(std::string_view bytes, const std::string& name, const char* kind)
      : bytes_(bytes), name_(name), kind_(kind) {}
  ~VtkXml() = default;

  /// Reads the file, calling begin and end for its tags.
  void parse();
  /// Called within begin: nothing behind this tag is looked at.
  void stop();
  virtual void begin(std::string_view tag, Attributes attributes) = 0;
  virtual void end() {}

  /// Tags from the outermost to the one that begins or ends.
  const std::vector<std::string>& path() const { return path_; }
  bool is_at(std::initializer_list<std::string_view> path) const;
  /// The outermost tag: VTKFile with this type, of version 0 to 2.
  void check_root(std::string_view tag, Attributes attributes, std::string_view type) const;
  /// The value of an attribute; empty if it is not there.
  static std::string find(Attributes attributes, std::string_view name);
  std::size_t line() const;
  /// Where the tag stands in the bytes.
  std::size_t tag_begin() const;
  std::size_t tag_end() const;

  const std::string_view bytes_;
  const std::string& name_;

 private:
  template <class Handler>
  void guard(Handler&& handler);
  void note_progress();

  const char* kind_;
  XML_ParserStruct* parser_ = nullptr;
  std::exception_ptr failure_;
  bool stopped_ = false;
  std::size_t seen_ = 0;  // where expat was last
  std::vector<std::string> path_;
};

}  // namespace nmp::fem
