!> What jobs are about: a system with names and units of its coordinates, and its loads.
module viscovib_subject
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_mount, only: mount_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: show
  use viscovib_tabulated, only: tabulated_unseen, unseen_integral
  implicit none
  private

  public :: subject_type

  !> Longest name of a coordinate or a unit.
  integer, parameter, public :: name_length = 16

  type :: subject_type
    !> A pendulum with loads of its own; else a mount or a polynomial system under `load`.
    logical :: is_pendulum = .false., is_polynomial = .false.
    type(pendulum_type) :: pendulum
    type(mount_type) :: mount
    type(polynomial_type) :: polynomial
    type(load_type) :: load
    character(len=name_length), allocatable :: coordinates(:), units(:)
  contains
    procedure :: oscillator
    procedure :: base_direction
    procedure :: remembers
    procedure :: warnings
  end type subject_type

contains

  !> The mount or the polynomial system.
  function oscillator(self)
    class(subject_type), intent(in), target :: self
    class(oscillator_type), pointer :: oscillator
    if (self%is_polynomial) then
      oscillator => self%polynomial
    else
      oscillator => self%mount
    end if
  end function oscillator

  !> How its coordinates move with the base.
  pure function base_direction(self)
    class(subject_type), intent(in) :: self
    real(wp), allocatable :: base_direction(:)
    if (self%is_polynomial) then
      base_direction = self%polynomial%base_direction
    else
      base_direction = self%mount%base_direction
    end if
  end function base_direction

  !> Whether its motion in time is that of a system with memory: of mounts always.
  pure logical function remembers(self)
    class(subject_type), intent(in) :: self
    remembers = .not. self%is_pendulum
    if (self%is_polynomial) remembers = any(self%polynomial%kernel_of > 0) &
                                        .or. self%polynomial%n_silent > 0
  end function remembers

  !> A line for each kernel in use whose integral is not between 0 and 1, or not known.
  function warnings(self) result(text)
    class(subject_type), intent(in), target :: self
    character(len=:), allocatable :: text
    class(oscillator_type), pointer :: system
    integer :: i

    text = ''
    if (self%is_pendulum) return
    system => self%oscillator()
    do i = 1, size(system%kernels)
      if (.not. any(system%kernel_of == i)) cycle
      associate (total => system%memory_scale*system%kernels(i)%kernel%integral())
        if (total >= 1) then
          text = text//'kernel integral = '//show(total)//' >= 1: the relaxed stiffness is not ' &
                 //'positive, and free motion creeps away slowly; the forced response to a load ' &
                 //'without a mean is unaffected'//new_line('a')
        else if (total < 0) then
          text = text//'kernel integral = '//show(total)//' < 0: the spring stiffens with ' &
                 //'time, which no relaxation does'//new_line('a')
        end if
      end associate
      associate (kernel => system%kernels(i)%kernel)
        if (unseen_integral(kernel) > tabulated_unseen*abs(kernel%integral())) then
          text = text//'kernel table: its first values rise towards t = 0 like a power of t: ' &
                 //'an integral of about '//show(unseen_integral(kernel))//' lies before its ' &
                 //'first time, which the table does not hold; the integral of the table is ' &
                 //show(kernel%integral())//new_line('a')
        end if
      end associate
    end do
  end function warnings

end module viscovib_subject
