!> Force laws that are no polynomials, as terms of a system: what each reads, and where it acts.
module viscovib_law_term
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: law_program, multiply, put_argument, put_number, subtract, wall
  implicit none
  private

  public :: law_term, about_rest, add_laws, add_law_slopes, new_law_term

  !> f(A u) on some equations, each with a weight; what is linear in it stands in the stiffness.
  type :: law_term
    type(law_program) :: program
    !> A, shape (n_arguments, n_dof).
    real(wp), allocatable :: arguments(:, :)
    !> The kernel behind which it stands (0: none), and its parity (see `parity_of`).
    integer :: kernel = 0, parity = 0
    !> Shape (n_targets), and the hereditary variables of these equations.
    integer, allocatable :: equations(:), variables(:)
    real(wp), allocatable :: weights(:)
  end type law_term

  !> How near to rest a law must have a value, on all sides.
  real(wp), parameter :: near = 1.0e-9_wp

contains

  !> A law of all coordinates as one without its linear part at rest, which is given apart.
  subroutine about_rest(law, slopes, defined)
    !> Its program reads the coordinates; its parity may be lost.
    type(law_term), intent(inout) :: law
    !> Derivatives at rest, shape (n_dof).
    real(wp), intent(out) :: slopes(:)
    !> Whether it has a value around rest.
    logical, intent(out) :: defined
    real(wp) :: at(2*size(slopes) + 1, size(slopes)), value(2*size(slopes) + 1)
    real(wp) :: by(2*size(slopes) + 1, size(slopes))
    integer :: i, n

    n = size(slopes)
    at = 0.0_wp
    do i = 1, n
      at(1 + i, i) = near
      at(1 + n + i, i) = -near
    end do
    call law%program%differentiate(at, value, by)
    defined = all(abs(value) < wall)
    slopes = by(1, :)
    if (law%parity == 1 .and. any(abs(slopes) > 0.0_wp)) law%parity = 0
    do i = 1, n
      if (.not. abs(slopes(i)) > 0.0_wp) cycle
      law%program%code = [law%program%code, put_argument, put_number, multiply, subtract]
      law%program%number = [law%program%number, real(i, wp), slopes(i), 0.0_wp, 0.0_wp]
    end do
    call law%program%measure()
  end subroutine about_rest

  !> A law from numbers: arguments, equations, instructions, kernel, parity; A (arguments n_dof);
  !! equation and weight of each target; code and number of each instruction.
  subroutine new_law_term(law, vector, n_dof, used)
    type(law_term), intent(out) :: law
    real(wp), intent(in) :: vector(:)
    integer, intent(in) :: n_dof
    !> How many numbers it took.
    integer, intent(out) :: used
    integer :: m, k, n

    m = nint(vector(1))
    k = nint(vector(2))
    n = nint(vector(3))
    law%kernel = nint(vector(4))
    law%parity = nint(vector(5))
    used = 5
    law%arguments = reshape(vector(used + 1:used + m*n_dof), [m, n_dof])
    used = used + m*n_dof
    law%equations = nint(vector(used + 1:used + 2*k:2))
    law%weights = vector(used + 2:used + 2*k:2)
    allocate (law%variables(k), source=0)
    used = used + 2*k
    law%program%n_arguments = m
    law%program%code = nint(vector(used + 1:used + 2*n:2))
    law%program%number = vector(used + 2:used + 2*n:2)
    used = used + 2*n
    call law%program%measure()
  end subroutine new_law_term

  !> Add the laws to the hereditary variables in which they stand.
  subroutine add_laws(laws, u, w)
    type(law_term), intent(in) :: laws(:)
    !> Shapes (n_samples, n_dof) and (n_samples, n_memory).
    real(wp), intent(in) :: u(:, :)
    real(wp), intent(inout) :: w(:, :)
    real(wp) :: value(size(u, 1))
    integer :: i, j

    do i = 1, size(laws)
      associate (law => laws(i))
        call law%program%evaluate(matmul(u, transpose(law%arguments)), value)
        do j = 1, size(law%variables)
          w(:, law%variables(j)) = w(:, law%variables(j)) + law%weights(j)*value
        end do
      end associate
    end do
  end subroutine add_laws

  !> Their derivatives by the coordinates.
  subroutine add_law_slopes(laws, u, slopes)
    type(law_term), intent(in) :: laws(:)
    real(wp), intent(in) :: u(:, :)
    !> Shape (n_samples, n_memory, n_dof).
    real(wp), intent(inout) :: slopes(:, :, :)
    real(wp) :: value(size(u, 1)), by_coordinate(size(u, 1), size(u, 2))
    real(wp), allocatable :: by_argument(:, :)
    integer :: b, i, j

    do i = 1, size(laws)
      associate (law => laws(i))
        allocate (by_argument(size(u, 1), law%program%n_arguments))
        call law%program%differentiate(matmul(u, transpose(law%arguments)), value, by_argument)
        by_coordinate = matmul(by_argument, law%arguments)
        deallocate (by_argument)
        do b = 1, size(u, 2)
          do j = 1, size(law%variables)
            slopes(:, law%variables(j), b) = slopes(:, law%variables(j), b) &
                                             + law%weights(j)*by_coordinate(:, b)
          end do
        end do
      end associate
    end do
  end subroutine add_law_slopes

end module viscovib_law_term
