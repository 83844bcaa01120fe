! Optimize: -O1
!> A task of the interface: its input and output by name, and the objects that it uses. An object is
!! a task whose result is kept, such as a system or a run that can be continued.
!!
!! Values that are not given to a task are taken from the objects that it uses.
module viscovib_task
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: i8, wp
  use viscovib_named_values, only: complex_value, integer_value, most_dimensions, named_values, &
    real_value, text_value
  use viscovib_oscillator, only: oscillator_type, speed_needed
  use viscovib_pendulum, only: pendulum_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: clipped, fail, show, status_input_error, status_type
  implicit none
  private

  public :: task_type, task_link, built_system, built_pendulum, built_kernel

  type :: task_link
    type(task_type), pointer :: to => null()
  end type task_link

  type :: task_type
    character(len=:), allocatable :: kind
    type(named_values) :: given, found
    type(task_link), allocatable :: parents(:)
    !> The created data, kept with the object.
    class(*), allocatable :: built
    !> The first error.
    type(status_type) :: status
    !> Number of handles and objects that use this one. It is deleted with the last of them.
    integer :: users = 1
    !> Set to a nonzero value by another thread to cancel the task.
    integer(c_int), pointer :: cancel => null()
  contains
    procedure :: has
    procedure :: get_real
    procedure :: get_integer
    procedure :: get_long
    procedure :: get_flag
    procedure :: get_text
    procedure :: take_text
    procedure :: get_reals
    procedure :: get_matrix
    procedure :: get_cube
    procedure :: get_complexes
    procedure :: get_complex_matrix
    procedure :: get_complex_cube
    procedure :: get_integers
    procedure :: get_longs
    procedure :: get_integer_matrix
    procedure :: check_extents
    procedure :: failed
    procedure :: refuse_kind
    procedure :: system
    procedure :: pendulum
    procedure :: kernel
    procedure, private :: place_of
  end type task_type

  !> Data of objects.
  type :: built_system
    class(oscillator_type), allocatable :: it
  end type built_system
  type :: built_pendulum
    type(pendulum_type) :: it
  end type built_pendulum
  type :: built_kernel
    type(kernel_holder) :: it
  end type built_kernel

  integer, parameter :: of_system = 1, of_pendulum = 2, of_kernel = 3
  character(len=*), parameter :: wanted(3) = [character(len=13) :: 'an oscillator', 'a pendulum', &
                                              'a kernel']

  ! Targets for arrays that were not given.
  real(wp), target :: no_reals(0)
  complex(wp), target :: no_complexes(0)

contains

  pure logical function failed(self)
    class(task_type), intent(in) :: self
    failed = self%status%failed()
  end function failed

  !> Fail because the kind of the task is unknown.
  subroutine refuse_kind(self)
    class(task_type), intent(inout) :: self
    call fail(self%status, status_input_error, 'task', "task '"//clipped(self%kind) &
              //"': is not known")
  end subroutine refuse_kind

  !> The task that has a value, and the index of the value there. Fails if there is none, unless it
  !! is optional.
  recursive subroutine place_of(self, name, kind, rank, holder, place, optional)
    class(task_type), intent(inout), target :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: kind, rank
    type(task_type), pointer, intent(out) :: holder
    integer, intent(out) :: place
    logical, intent(in) :: optional
    integer :: i

    holder => self
    place = self%given%find(name)
    if (place == 0 .and. allocated(self%parents)) then
      do i = 1, size(self%parents)
        call self%parents(i)%to%place_of(name, kind, rank, holder, place, .true.)
        if (place > 0) exit
      end do
    end if
    if (place == 0) then
      if (.not. (optional .or. self%failed())) then
        call fail(self%status, status_input_error, name, name//': must be given to '//self%kind)
      end if
    else if (holder%given%places(place)%kind /= kind &
             .or. holder%given%places(place)%rank /= rank) then
      if (.not. self%failed()) then
        call fail(self%status, status_input_error, name, name//': has another type or number of ' &
                  //'dimensions than '//self%kind//' takes, must be of rank '//show(rank))
      end if
      place = 0
    end if
  end subroutine place_of

  !> True if a value was given, of any kind.
  recursive logical function has(self, name)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer :: i
    has = self%given%find(name) > 0
    if (has .or. .not. allocated(self%parents)) return
    do i = 1, size(self%parents)
      has = self%parents(i)%to%has(name)
      if (has) return
    end do
  end function has

  real(wp) function get_real(self, name, default) result(value)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), intent(in), optional :: default
    type(task_type), pointer :: holder
    integer :: place
    value = 0.0_wp
    if (present(default)) value = default
    call self%place_of(name, real_value, 0, holder, place, present(default))
    if (place > 0) value = holder%given%numbers(holder%given%places(place)%before + 1)
  end function get_real

  integer(i8) function get_long(self, name, default) result(value)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(i8), intent(in), optional :: default
    type(task_type), pointer :: holder
    integer :: place
    value = 0_i8
    if (present(default)) value = default
    call self%place_of(name, integer_value, 0, holder, place, present(default))
    if (place > 0) value = holder%given%integers(holder%given%places(place)%before + 1)
  end function get_long

  integer function get_integer(self, name, default) result(value)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in), optional :: default
    integer(i8) :: long
    if (present(default)) then
      long = self%get_long(name, int(default, i8))
    else
      long = self%get_long(name)
    end if
    value = 0
    if (abs(long) <= huge(value)) then
      value = int(long)
    else if (.not. self%failed()) then
      call fail(self%status, status_input_error, name, name//': must be an integer of at most ' &
                //show(huge(value)))
    end if
  end function get_integer

  logical function get_flag(self, name, default) result(value)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    logical, intent(in), optional :: default
    if (present(default)) then
      value = self%get_long(name, merge(1_i8, 0_i8, default)) /= 0_i8
    else
      value = self%get_long(name) /= 0_i8
    end if
  end function get_flag

  !> Get a text, also if threads run the same task. gfortran keeps the length of the result of
  !! `get_text` in static memory, so only tasks about texts, which one thread at a time runs, may
  !! call `get_text`.
  subroutine take_text(self, name, text, default)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    character(len=:), allocatable, intent(out) :: text
    character(len=*), intent(in), optional :: default
    type(task_type), pointer :: holder
    integer :: place
    if (present(default)) then
      text = default
    else
      text = ''
    end if
    call self%place_of(name, text_value, 1, holder, place, present(default))
    if (place == 0) return
    associate (at => holder%given%places(place))
      text = holder%given%letters(at%before + 1:at%before + at%size)
    end associate
  end subroutine take_text

  function get_text(self, name, default) result(text)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    character(len=*), intent(in), optional :: default
    character(len=:), allocatable :: text
    call self%take_text(name, text, default)
  end function get_text

  !> Elements and extents of an array, valid as long as the task exists; empty if not
  !! given.
  subroutine find_reals(self, name, rank, row, n)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: rank
    real(wp), pointer, contiguous, intent(out) :: row(:)
    integer, intent(out) :: n(most_dimensions)
    type(task_type), pointer :: holder
    integer :: place
    row => no_reals
    n = 0
    call self%place_of(name, real_value, rank, holder, place, .false.)
    if (place == 0) return
    row => holder%given%reals_at(place)
    n = holder%given%places(place)%extents
  end subroutine find_reals

  function get_reals(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), pointer, contiguous :: values(:)
    integer :: n(most_dimensions)
    call find_reals(self, name, 1, values, n)
  end function get_reals

  function get_matrix(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), pointer, contiguous :: values(:, :), row(:)
    integer :: n(most_dimensions)
    call find_reals(self, name, 2, row, n)
    values(1:n(1), 1:n(2)) => row
  end function get_matrix

  function get_cube(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    real(wp), pointer, contiguous :: values(:, :, :), row(:)
    integer :: n(most_dimensions)
    call find_reals(self, name, 3, row, n)
    values(1:n(1), 1:n(2), 1:n(3)) => row
  end function get_cube

  !> Elements and extents of an array of complex numbers, as in `find_reals`.
  subroutine find_complexes(self, name, rank, row, n)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: rank
    complex(wp), pointer, contiguous, intent(out) :: row(:)
    integer, intent(out) :: n(most_dimensions)
    type(task_type), pointer :: holder
    integer :: place
    row => no_complexes
    n = 0
    call self%place_of(name, complex_value, rank, holder, place, .false.)
    if (place == 0) return
    row => holder%given%complexes_at(place)
    n = holder%given%places(place)%extents
  end subroutine find_complexes

  function get_complexes(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    complex(wp), pointer, contiguous :: values(:)
    integer :: n(most_dimensions)
    call find_complexes(self, name, 1, values, n)
  end function get_complexes

  function get_complex_matrix(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    complex(wp), pointer, contiguous :: values(:, :), row(:)
    integer :: n(most_dimensions)
    call find_complexes(self, name, 2, row, n)
    values(1:n(1), 1:n(2)) => row
  end function get_complex_matrix

  function get_complex_cube(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    complex(wp), pointer, contiguous :: values(:, :, :), row(:)
    integer :: n(most_dimensions)
    call find_complexes(self, name, 3, row, n)
    values(1:n(1), 1:n(2), 1:n(3)) => row
  end function get_complex_cube

  function get_longs(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer(i8), allocatable :: values(:)
    type(task_type), pointer :: holder
    integer :: place
    call self%place_of(name, integer_value, 1, holder, place, .false.)
    if (place > 0) then
      associate (at => holder%given%places(place))
        values = holder%given%integers(at%before + 1:at%before + at%size)
      end associate
    else
      allocate (values(0))
    end if
  end function get_longs

  function get_integers(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, allocatable :: values(:)
    values = int(self%get_longs(name))
  end function get_integers

  function get_integer_matrix(self, name) result(values)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, allocatable :: values(:, :)
    type(task_type), pointer :: holder
    integer :: place
    call self%place_of(name, integer_value, 2, holder, place, .false.)
    if (place > 0) then
      associate (at => holder%given%places(place))
        values = reshape(int(holder%given%integers(at%before + 1:at%before + at%size)), &
                         at%extents(:2))
      end associate
    else
      allocate (values(0, 0))
    end if
  end function get_integer_matrix

  !> Fail if an array does not have the required extents.
  subroutine check_extents(self, name, found, wanted)
    class(task_type), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: found(:), wanted(:)
    integer :: i
    if (self%failed()) return
    do i = 1, size(wanted)
      if (found(i) == wanted(i)) cycle
      call fail(self%status, status_input_error, name, name//': has an extent of '//show(found(i)) &
                //' in dimension '//show(i)//', must be '//show(wanted(i)))
      return
    end do
  end subroutine check_extents

  !> The oscillator of the task. The task fails if there is none, or if it depends on the speed and
  !! `with_speed` does not say that the task takes such systems.
  function system(self, with_speed, with_shaft) result(it)
    class(task_type), intent(inout), target :: self
    logical, intent(in), optional :: with_speed, with_shaft
    class(oscillator_type), pointer :: it
    type(task_link) :: holder
    nullify (it)
    select type (self)
    type is (task_type)
      holder = holder_of(self, of_system)
    end select
    if (.not. associated(holder%to)) return
    select type (own => holder%to%built)
    type is (built_system)
      it => own%it
    end select
    if (.not. associated(it)) return
    if (.not. present(with_shaft)) call refuse_shaft(self, it)
    if (present(with_speed)) return
    if (it%depends_on_speed() .and. .not. self%failed()) then
      call fail(self%status, status_input_error, 'speed', speed_needed)
    end if
  end function system

  subroutine refuse_shaft(task, system)
    class(task_type), intent(inout) :: task
    class(oscillator_type), intent(in) :: system
    select type (system)
    type is (polynomial_type)
      if (allocated(system%shaft) .and. .not. task%failed()) then
        call fail(task%status, status_input_error, 'system', 'system: the speed of its shaft ' &
                  //'changes, so only motions in time are available')
      end if
    end select
  end subroutine refuse_shaft

  function pendulum(self) result(it)
    class(task_type), intent(inout), target :: self
    type(pendulum_type), pointer :: it
    type(task_link) :: holder
    nullify (it)
    select type (self)
    type is (task_type)
      holder = holder_of(self, of_pendulum)
    end select
    if (.not. associated(holder%to)) return
    select type (own => holder%to%built)
    type is (built_pendulum)
      it => own%it
    end select
  end function pendulum

  function kernel(self) result(it)
    class(task_type), intent(inout), target :: self
    type(kernel_holder), pointer :: it
    type(task_link) :: holder
    nullify (it)
    select type (self)
    type is (task_type)
      holder = holder_of(self, of_kernel)
    end select
    if (.not. associated(holder%to)) return
    select type (own => holder%to%built)
    type is (built_kernel)
      it => own%it
    end select
  end function kernel

  !> The object with the required data; the task fails if there is none.
  function holder_of(task, what) result(holder)
    type(task_type), intent(inout), target :: task
    integer, intent(in) :: what
    type(task_link) :: holder
    call seek(task, what, holder)
    if (associated(holder%to) .or. task%failed()) return
    call fail(task%status, status_input_error, 'task', task%kind//': needs '//trim(wanted(what)))
  end function holder_of

  recursive subroutine seek(task, what, holder)
    type(task_type), intent(in), target :: task
    integer, intent(in) :: what
    type(task_link), intent(out) :: holder
    integer :: found, i
    found = 0
    if (allocated(task%built)) then
      select type (own => task%built)
      type is (built_system)
        found = of_system
      type is (built_pendulum)
        found = of_pendulum
      type is (built_kernel)
        found = of_kernel
      end select
    end if
    if (found == what) then
      holder%to => task
      return
    end if
    if (.not. allocated(task%parents)) return
    do i = 1, size(task%parents)
      call seek(task%parents(i)%to, what, holder)
      if (associated(holder%to)) return
    end do
  end subroutine seek

end module viscovib_task
