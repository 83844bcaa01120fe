! Optimize: -O2 -fvect-cost-model=dynamic
!> Polynomial form from equations computed with jets.
module viscovib_jet_form
  use viscovib_jet, only: jet_type
  use viscovib_kinds, only: wp
  use viscovib_polynomial_form, only: polynomial_form_type, term_type
  implicit none
  private

  public :: take_terms

contains

  !> Copy linear, quadratic and cubic terms of the equations to the form. Linear terms go to A_k or,
  !! with memory, to H. `source`, `derivative` and `kernel_of` are already set.
  pure subroutine take_terms(form, equations)
    type(polynomial_form_type), intent(inout) :: form
    type(jet_type), intent(in) :: equations(:)
    type(term_type), allocatable :: quadratic(:), cubic(:)
    integer :: row, i, j, k, n2, n3, m

    m = form%n_arguments
    if (.not. allocated(form%linear)) then
      allocate (form%linear(form%n, form%n, 0:2), form%hereditary(form%n, form%n), source=0.0_wp)
    end if
    do row = 1, form%n
      do i = 1, m
        associate (entry => equations(row)%c1(i), j => form%source(i))
          if (form%kernel_of(row) > 0) then
            form%hereditary(row, j) = form%hereditary(row, j) + entry
          else
            associate (a => form%linear(row, j, form%derivative(i)))
              a = a + entry
            end associate
          end if
        end associate
      end do
    end do
    allocate (quadratic(form%n*m*m), cubic(form%n*m**3))
    n2 = 0
    n3 = 0
    do row = 1, form%n
      do i = 1, m
        do j = i, m
          call add(quadratic, n2, [i, j, 0], equations(row)%c2(i, j)*merge(1, 2, i == j))
          do k = j, m
            call add(cubic, n3, [i, j, k], equations(row)%c3(i, j, k)*arrangements(i, j, k))
          end do
        end do
      end do
    end do
    form%quadratic = quadratic(:n2)
    form%cubic = cubic(:n3)

  contains

    pure subroutine add(terms, n, at, coefficient)
      type(term_type), intent(inout) :: terms(:)
      integer, intent(inout) :: n
      integer, intent(in) :: at(3)
      real(wp), intent(in) :: coefficient
      if (.not. abs(coefficient) > 0.0_wp) return
      n = n + 1
      terms(n) = term_type(row, at, coefficient)
    end subroutine add

  end subroutine take_terms

  !> Number of distinct permutations of three indices, i <= j <= k.
  pure integer function arrangements(i, j, k)
    integer, intent(in) :: i, j, k
    arrangements = 6
    if (i == j .or. j == k) arrangements = 3
    if (i == k) arrangements = 1
  end function arrangements

end module viscovib_jet_form
