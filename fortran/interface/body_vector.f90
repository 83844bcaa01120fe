!> Conversion of a vector of numbers to a body with finite rotations:
!!
!!   number of coordinates n, of springs, of kernels; loads in body axes (1); h (3); M and C, base
!!   direction (n); for each spring: kernel (0: none), rotational (1), direction (3), arm (3),
!!   stiffness, damping, static load, coordinate of its track (0: none), number of coefficients of
!!   d^2, d^3, ... and these, laws of one coordinate; kernels (`viscovib_number_reader`).
module viscovib_body_vector
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: put_argument
  use viscovib_law_term, only: law_term
  use viscovib_mounted_body, only: mounted_body
  use viscovib_number_reader, only: number_reader
  use viscovib_status, only: status_type
  use viscovib_turning_body, only: body_spring, new_turning_body, turning_body
  implicit none
  private

  public :: body_from_vector, mounted_from_vector

contains

  subroutine body_from_vector(body, vector, status)
    type(turning_body), intent(out) :: body
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    type(body_spring), allocatable :: springs(:)
    type(kernel_holder), allocatable :: kernels(:)
    real(wp), allocatable :: mass(:, :), damping(:, :), direction(:)

    call read_body(vector, mass, damping, direction, springs, kernels, status)
    if (status%failed()) return
    call new_turning_body(body, mass, damping, direction, springs, kernels)
    body%loads_turn = nint(vector(4)) == 1
    body%spin_inside = vector(5:7)
  end subroutine body_from_vector

  !> A body as given, before it rests; its laws depend on d and its rate, and its stiffnesses do not
  !! contain their slopes.
  subroutine mounted_from_vector(body, kernels, vector, status)
    type(mounted_body), intent(out) :: body
    type(kernel_holder), allocatable, intent(out) :: kernels(:)
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    real(wp), allocatable :: mass(:, :), damping(:, :)
    integer :: i, j

    call read_body(vector, mass, damping, body%base_direction, body%springs, kernels, status)
    if (status%failed()) return
    body%mass = mass(1, 1)
    body%inertia = mass(4:6, 4:6)
    body%track_mass = [(mass(i, i), i=7, size(mass, 1))]
    body%track_damping = [(damping(i, i), i=7, size(mass, 1))]
    do j = 1, size(body%springs)
      do i = 1, size(body%springs(j)%laws)
        call read_both(body%springs(j)%laws(i))
      end do
    end do
  end subroutine mounted_from_vector

  !> Let the program of a law of one coordinate read d and its rate, used or not.
  subroutine read_both(law)
    type(law_term), intent(inout) :: law
    integer :: k
    do k = 1, size(law%program%code)
      if (law%program%code(k) /= put_argument) cycle
      associate (place => law%program%number(k))
        place = merge(1.0_wp, 2.0_wp, abs(law%arguments(nint(place), 1)) > 0.0_wp)
      end associate
    end do
    law%program%n_arguments = 2
    call law%program%measure()
  end subroutine read_both

  subroutine read_body(vector, mass, damping, direction, springs, kernels, status)
    real(wp), intent(in) :: vector(:)
    real(wp), allocatable, intent(out) :: mass(:, :), damping(:, :), direction(:)
    type(body_spring), allocatable, intent(out) :: springs(:)
    type(kernel_holder), allocatable, intent(out) :: kernels(:)
    type(status_type), intent(out) :: status
    type(number_reader) :: next
    real(wp) :: head(13)
    integer :: i, n, n_kernels

    call next%start(vector, 7, 'body', status)
    if (status%failed()) return
    n = next%whole()
    allocate (springs(next%whole()))
    n_kernels = next%whole()
    next%at = 7
    mass = next%matrix(n, n)
    damping = next%matrix(n, n)
    direction = next%row(n)
    do i = 1, size(springs)
      associate (spring => springs(i))
        head = next%row(13)
        spring%kernel = nint(head(1))
        spring%turning = nint(head(2)) == 1
        spring%direction = head(3:5)
        spring%arm = head(6:8)
        spring%stiffness = head(9)
        spring%damping = head(10)
        spring%preload = head(11)
        spring%track = nint(head(12))
        spring%coefficient = next%row(nint(head(13)))
        call next%laws(1, spring%laws)
      end associate
    end do
    call next%kernels(n_kernels, kernels, status)
  end subroutine read_body

end module viscovib_body_vector
